"""``python -m contact_sim``: what the simulator does without the client."""

from __future__ import annotations

import typer

from contact_sim.console import run_app
from contact_sim.sensing.gl import load_mujoco


def commands() -> typer.Typer:
    """The commands; whoever imports them imports mujoco, which MUJOCO_GL may break.

    Raises:
        RenderError: it does.
    """
    load_mujoco()
    from contact_sim.commands import app

    return app


def main() -> None:
    """Run a command."""
    run_app(commands, "contact_sim")


if __name__ == "__main__":
    main()
