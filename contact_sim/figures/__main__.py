"""``python -m contact_sim.figures``."""

from __future__ import annotations

import typer

from contact_sim.console import run_app
from contact_sim.figures.command import figures


def main() -> None:
    """Draw."""
    app = typer.Typer(
        pretty_exceptions_enable=False,
        add_completion=False,
        rich_markup_mode=None,  # at 80 columns its tables cut the names of flags
    )
    app.command()(figures)
    run_app(app, "figures", "scripts/figures")


if __name__ == "__main__":
    main()
