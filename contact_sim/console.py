"""The end of a command line, whichever of this package's it is."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from types import FrameType

import typer
from rich.console import Console

from contact_sim.errors import SimulatorError


def run_app(commands: Callable[[], typer.Typer], name: str, shown_as: str | None = None) -> None:
    """Run a command; a user's mistake ends in one line and exit code 2, never a traceback.

    Either signal is an interrupt, so that whatever was started ends with it.

    Args:
        commands: imports its commands: what is wrong with this machine is told, too.
        name: what the line begins with.
        shown_as: the program's name in its help; None: as it was called.
    """
    for sign in (signal.SIGINT, signal.SIGTERM):  # a script's background job is born deaf to SIGINT
        signal.signal(sign, _interrupt)
    try:
        commands()(prog_name=shown_as, standalone_mode=True)
    except SimulatorError as error:
        line = " ".join(str(error).split())
        Console(stderr=True).print(f"{name}: {line}", style="red", markup=False, soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
