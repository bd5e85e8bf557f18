"""The command's own small parts; what it does is in tests/integration/test_hil_command.py."""

from __future__ import annotations

from typer.testing import CliRunner

from contact_sim.commands import app


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
