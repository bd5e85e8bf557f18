"""``evaluate``: the command around the scoring."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from detector_training.commands.shell import one_line_errors
from detector_training.datasets.sample import load_dataset
from detector_training.evaluation.scores import Report, Scores, evaluate_detector
from detector_training.training import loop as training
from edge_service.detector.engine import SCORE_THRESHOLD, TorchDetector
from target_pose.target import load_target

AP_SCORE_THRESHOLD = 0.02
"""Low, so that the precision-recall curve is whole."""


def register(app: typer.Typer) -> None:
    """Add ``evaluate`` to a command line."""
    app.command("evaluate")(evaluate)


def evaluate(
    weights: Annotated[Path, typer.Argument(help="A run's folder or a weights file.")],
    data: Annotated[Path, typer.Argument(help="Data set: images/ and labels.jsonl.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    workers: Annotated[int | None, typer.Option(help="CPUs to use; default: all.")] = None,
    target: Annotated[str, typer.Option(help="Target that the data shows.")] = "bullseye-400",
) -> None:
    """Score a detector: AP, recall and false alarms per level and per condition."""
    with one_line_errors():
        path = weights / training.WEIGHTS if weights.is_dir() else weights
        samples, shape = load_dataset(data), load_target(target)
        detector = TorchDetector(path, threads=workers, score_threshold=AP_SCORE_THRESHOLD)
        scores = evaluate_detector(detector.detect, samples, shape)
        if as_json:
            typer.echo(json.dumps(scores.as_json(), indent=1))
        else:
            print_report(Console(), scores)


def print_report(console: Console, report: Report) -> None:
    """Show a report as a table."""
    table = Table(
        title=f"{report.pictures} pictures, recall and false alarms at score {SCORE_THRESHOLD}"
    )
    for name in ("condition", "what", "truths", "AP50", "AP50-95", "recall", "false/picture"):
        table.add_column(name, justify="left" if name in ("condition", "what") else "right")
    for condition, rows in report.rows.items():
        for what, s in rows.items():
            table.add_row(condition, what, *_cells(s))
        table.add_section()
    console.print(table)


def _cells(s: Scores) -> list[str]:
    shares = ["-" if x is None else f"{x:.3f}" for x in (s.ap50, s.ap50_95, s.recall)]
    return [str(s.truths), *shares, f"{s.false_per_picture:.3f}"]
