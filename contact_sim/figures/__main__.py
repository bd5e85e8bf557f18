"""``python -m contact_sim.figures``."""

from __future__ import annotations

import typer

from contact_sim.console import run_app
from contact_sim.sensing.gl import load_mujoco


def commands() -> typer.Typer:
    """The command; whoever imports it imports mujoco, which MUJOCO_GL may break.

    Raises:
        RenderError: it does.
    """
    load_mujoco()
    from contact_sim.figures.command import figures

    app = typer.Typer(
        pretty_exceptions_enable=False,
        add_completion=False,
        rich_markup_mode=None,  # at 80 columns its tables cut the names of flags
    )
    app.command()(figures)
    return app


def main() -> None:
    """Draw."""
    run_app(commands, "figures", "scripts/figures")


if __name__ == "__main__":
    main()
