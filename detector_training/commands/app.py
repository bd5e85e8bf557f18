"""``python -m detector_training``: every command, and nothing else."""

from __future__ import annotations

import typer

from detector_training.commands import scenes, target
from detector_training.commands.shell import one_line_errors

app = typer.Typer(
    help="Print the target, make pictures of it, train the detector on them, measure it.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
target.register(app)
scenes.register(app)


def main() -> None:
    """Run a sub-command; what the user got wrong is one line and exit status 2."""
    # here, not above: the processes that render import this module and need no torch
    from detector_training.commands import dataset, evaluate, export, train

    dataset.register(app)
    train.register(app)
    evaluate.register(app)
    export.register(app)
    with one_line_errors():
        app(standalone_mode=True)
