"""``python -m contact_sim.figures``."""

from __future__ import annotations

import sys

import typer
from rich.console import Console

from contact_sim.errors import SimulatorError
from contact_sim.figures.command import figures


def main() -> None:
    """Draw; a user's mistake ends in one line and exit code 2, never a traceback."""
    app = typer.Typer(
        pretty_exceptions_enable=False,
        add_completion=False,
        rich_markup_mode=None,  # at 80 columns its tables cut the names of flags
    )
    app.command()(figures)
    try:
        app(prog_name="scripts/figures")
    except SimulatorError as error:
        line = " ".join(str(error).split())
        Console(stderr=True).print(f"figures: {line}", style="red", markup=False, soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
