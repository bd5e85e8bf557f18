"""``train``: the command around the training loop."""

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

from detector_training.commands.evaluate import AP_SCORE_THRESHOLD, print_report
from detector_training.commands.shell import one_line_errors
from detector_training.datasets.sample import load_dataset
from detector_training.evaluation.scores import evaluate_detector
from detector_training.training import loop as training
from detector_training.training.plot import plot_log
from edge_service.detector.engine import TorchDetector
from edge_service.detector.threads import available_cpus
from target_pose.target import load_target

LINE_EVERY_S = 30.0
"""How often a line is printed where there is no terminal for a bar."""


def register(app: typer.Typer) -> None:
    """Add ``train`` to a command line."""
    app.command("train")(train)


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
    with one_line_errors("stopped; go on with --resume"):
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
            print_report(console, scores)


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
