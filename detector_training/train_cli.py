"""``train`` and ``evaluate``: the commands around the training loop and the scoring."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from detector_training import train as training
from detector_training.dataset import load_dataset
from detector_training.errors import TrainingError
from detector_training.evaluate import Report, Scores, evaluate_detector
from detector_training.plot import plot_log
from edge_service.detector.engine import SCORE_THRESHOLD, TorchDetector
from edge_service.detector.threads import available_cpus
from edge_service.errors import EdgeError
from target_pose.errors import TargetError
from target_pose.target import load_target

LINE_EVERY_S = 30.0
"""How often a line is printed where there is no terminal for a bar."""

AP_SCORE_THRESHOLD = 0.02
"""Low, so that the precision-recall curve is whole."""


def register(app: typer.Typer) -> None:
    """Add ``train`` and ``evaluate`` to a command line."""
    app.command("train")(train)
    app.command("evaluate")(evaluate)


def train(
    data: Annotated[Path, typer.Argument(help="Data set: images/ and labels.jsonl.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the run.")],
    val: Annotated[Path | None, typer.Option("--val", help="Data set to score at the end.")] = None,
    minutes: Annotated[float | None, typer.Option(help="Length of the run.")] = None,
    epochs: Annotated[int | None, typer.Option(help="Length of the run, instead.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything left to chance.")] = 0,
    learning_rate: Annotated[float, typer.Option(help="Highest learning rate.")] = 2e-3,
    workers: Annotated[int | None, typer.Option(help="CPUs to use; default: all.")] = None,
    target: Annotated[str, typer.Option(help="Target that the data shows.")] = "bullseye-400",
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the run in --out.")] = False,
) -> None:
    """Train the detector on a data set; leaves weights, a log and its plot in --out."""
    with _one_line_errors():
        settings = training.TrainSettings(
            minutes,
            epochs,
            seed,
            learning_rate=learning_rate,
            target=target,
            workers=available_cpus() if workers is None else workers,
        )
        samples = load_dataset(data)
        held_out = load_dataset(val) if val else ()
        console = Console()
        console.print(f"{len(samples)} pictures to train on, run in {out}")
        with _progress(console) as report:
            weights = training.train(samples, out, settings, resume=resume, report=report)
        plot_log(out / training.LOG, out / "loss.png")
        console.print(f"weights: {weights}")
        if held_out:
            detector = TorchDetector(
                weights, threads=settings.workers, score_threshold=AP_SCORE_THRESHOLD
            )
            scores = evaluate_detector(detector.detect, held_out, load_target(target))
            (out / "evaluation.json").write_text(json.dumps(scores.as_json(), indent=1) + "\n")
            _print_report(console, scores)


def evaluate(
    weights: Annotated[Path, typer.Argument(help="A run's folder or a weights file.")],
    data: Annotated[Path, typer.Argument(help="Data set: images/ and labels.jsonl.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    workers: Annotated[int | None, typer.Option(help="CPUs to use; default: all.")] = None,
    target: Annotated[str, typer.Option(help="Target that the data shows.")] = "bullseye-400",
) -> None:
    """Score a detector: AP, recall and false alarms per level and per condition."""
    with _one_line_errors():
        path = weights / training.WEIGHTS if weights.is_dir() else weights
        samples, shape = load_dataset(data), load_target(target)
        detector = TorchDetector(path, threads=workers, score_threshold=AP_SCORE_THRESHOLD)
        scores = evaluate_detector(detector.detect, samples, shape)
        if as_json:
            typer.echo(json.dumps(scores.as_json(), indent=1))
        else:
            _print_report(Console(), scores)


@contextmanager
def _one_line_errors() -> Iterator[None]:
    """Turn the errors that we foresee into one line and exit code 2; Ctrl-C into 130."""
    try:
        yield
    except (TrainingError, EdgeError, TargetError) as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(2) from None
    except KeyboardInterrupt:
        typer.echo("stopped; go on with --resume", err=True)
        raise typer.Exit(130) from None


@contextmanager
def _progress(console: Console) -> Iterator[Callable[[training.Progress], None]]:
    """A live bar on a terminal, else a line now and then."""
    start = time.monotonic()
    if not sys.stdout.isatty():
        last = start

        def line(p: training.Progress) -> None:
            nonlocal last
            if (now := time.monotonic()) - last >= LINE_EVERY_S:
                last = now
                console.print(
                    f"{p.share:6.1%}  step {p.step}  pictures {p.images}  loss {p.loss:.3f}"
                )

        yield line
        return
    text = TextColumn("step {task.fields[step]}  loss {task.fields[loss]:.3f}")
    with Progress(BarColumn(), text, TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task("", total=1.0, step=0, loss=float("nan"))
        yield lambda p: bar.update(task, completed=p.share, step=p.step, loss=p.loss)


def _print_report(console: Console, report: Report) -> None:
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
