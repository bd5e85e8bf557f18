"""The command's own small parts; what it does is in tests/integration/test_hil_command.py."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from contact_sim.__main__ import app
from contact_sim.errors import HilError
from contact_sim.hil.command import address_of


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:4560", ("127.0.0.1", 4560)),
        ("localhost:0", ("localhost", 0)),
        ("[::1]:4560", ("::1", 4560)),
    ],
)
def test_an_address_is_host_and_port(text, address):
    """As everywhere."""
    assert address_of(text) == address


@pytest.mark.parametrize(
    "text", ["", "4560", ":4560", "host:", "host:65536", "host:-1", "host:4a", "h" * 300 + ":1"]
)
def test_what_is_no_address_is_said_with_an_example(text):
    """And cut, if somebody pasted a novel."""
    with pytest.raises(HilError, match=r"is no address to listen at, such as 127\.0\.0\.1:4560"):
        address_of(text)


def test_the_help_teaches():
    """How to begin, what PX4 needs, where the parameters are, what the exit codes mean."""
    said = " ".join(CliRunner().invoke(app, ["hil", "--help"]).output.split())
    for words in (
        "make px4_sitl none_iris",
        "commander takeoff",
        "docs/px4.md",
        "Exit code 0",
        "Example: python -m contact_sim hil --world tunnel --seed 3",
        "THR_MDL_FAC",
    ):
        assert words in said
