"""``python -m contact_sim``: what the simulator does without the client."""

from __future__ import annotations

import signal
import sys
from types import FrameType

import typer
from rich.console import Console

from contact_sim.campaign.command import campaign
from contact_sim.errors import SimulatorError
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
    """Run a command; a user's mistake ends in one line and exit code 2, never a traceback."""
    for sign in (signal.SIGINT, signal.SIGTERM):  # a script's background job is born deaf to SIGINT
        signal.signal(sign, _interrupt)
    try:
        app(standalone_mode=True)
    except SimulatorError as error:
        line = " ".join(str(error).split())
        Console(stderr=True).print(
            f"contact_sim: {line}", style="red", markup=False, soft_wrap=True
        )
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
