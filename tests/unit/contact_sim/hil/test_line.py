"""Addresses; sockets themselves are tried in tests/integration."""

from __future__ import annotations

import pytest

from contact_sim.errors import HilError
from contact_sim.hil.line import address_of


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
