"""``python -m contact_sim``: what the simulator does without the client."""

from __future__ import annotations

import typer

from contact_sim.campaign.command import campaign
from contact_sim.console import run_app
from contact_sim.hil.command import hil

app = typer.Typer(
    help="A simulated drone. The real client flies it with drone-client fly --sim; this is the "
    "rest.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,  # at 80 columns its tables cut the names of flags
)
app.command()(hil)
app.command()(campaign)


def main() -> None:
    """Run a command."""
    run_app(app, "contact_sim")


if __name__ == "__main__":
    main()
