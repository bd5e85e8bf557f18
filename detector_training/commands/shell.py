"""What all commands share: the console for people, and one line for what the user got wrong."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer
from rich.console import Console

from detector_training.errors import TrainingError
from edge_service.errors import EdgeError
from target_pose.errors import TargetError

console = Console(stderr=True)


def command_line() -> str:
    """How this process was started, as one would type it."""
    return shlex.join(["python", "-m", "detector_training", *sys.argv[1:]])


@contextmanager
def one_line_errors(advice: str = "stopped") -> Iterator[None]:
    """Turn the errors that we foresee into one line and exit status 2; Ctrl-C into 130.

    Args:
        advice: What to say after Ctrl-C.
    """
    try:
        yield
    except (TrainingError, EdgeError, TargetError) as error:
        typer.echo(f"error: {error}", err=True)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        typer.echo(advice, err=True)
        raise SystemExit(130) from None
