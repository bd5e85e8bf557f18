"""``evaluate``: the command around the scoring."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from detector_training.commands.shell import command_line, one_line_errors
from detector_training.commands.shell import console as progress_console
from detector_training.datasets.output import write_file
from detector_training.datasets.sample import load_dataset
from detector_training.errors import EvaluationError
from detector_training.evaluation.fly_by import fly_by, load_recording, plot_fly_by
from detector_training.evaluation.groups import By
from detector_training.evaluation.matching import MIN_PX, MIN_VISIBLE, Counting
from detector_training.evaluation.report import (
    TITLES,
    operating_point_text,
    share_text,
    write_report,
)
from detector_training.evaluation.run import run_detector
from detector_training.evaluation.scores import Report, score
from detector_training.training import loop as training
from edge_service.detector.detector import SCORE_THRESHOLD
from edge_service.detector.engines import ENGINES, open_engine
from target_pose.target import Target, load_round_target

AP_SCORE_THRESHOLD = 0.02
"""Low, so that the precision-recall curve is whole."""


SHORT = "{:.3f} [{:.2f}-{:.2f}]"


def register(app: typer.Typer) -> None:
    """Add ``evaluate`` to a command line."""
    app.command("evaluate")(evaluate)


def evaluate(
    weights: Annotated[Path, typer.Argument(help="A run's folder or a weights file.")],
    data: Annotated[
        Path, typer.Argument(help="Data set, or with --fly-by a recording in the TUM layout.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="New folder for report.md, report.json, plots, worst cases."),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--fly-by",
            help="DATA is a recording with truth.json: draw its detections over time to this PNG.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    fp_per_1000: Annotated[
        float,
        typer.Option(help="Also: recall with at most this many false positives in 1000 pictures."),
    ] = 1.0,
    min_px: Annotated[
        float, typer.Option(help="Narrower targets neither count as missed nor as false.")
    ] = MIN_PX,
    min_visible: Annotated[
        float, typer.Option(help="Likewise levels of which less can be seen, 0 to 1.")
    ] = MIN_VISIBLE,
    engine: Annotated[
        str, typer.Option(help=f"What runs the net: {', '.join(ENGINES)}; .onnx: the latter two.")
    ] = "torch",
    workers: Annotated[int | None, typer.Option(help="CPUs to use; default: all.")] = None,
    target: Annotated[str, typer.Option(help="Target that the data shows.")] = "bullseye-400",
) -> None:
    """Score a detector: AP, recall and false alarms per level, condition, distance and size.

    Every number has its 95 % interval. `candidate` is a whole target after the nesting check:
    what the drone would have flown to.

    Example: python -m detector_training evaluate runs/a runs/test --out runs/a/report
    """
    with one_line_errors():
        counting = Counting(min_px, min_visible)
        if not 0 <= fp_per_1000 <= 1000:
            raise EvaluationError(f"--fp-per-1000 {fp_per_1000:g}: give a rate from 0 to 1000")
        if plot is not None and out is not None:
            raise EvaluationError("--fly-by draws one picture; leave out --out")
        path = weights / training.WEIGHTS if weights.is_dir() else weights
        shape = load_round_target(target)
        if plot is not None:
            _fly_by(path, data, plot, shape, as_json, workers, engine)
            return
        samples = load_dataset(data)
        if out is not None and out.exists() and (out.is_file() or any(out.iterdir())):
            raise EvaluationError(f"{out} holds something already; name a new folder")
        detector = open_engine(engine, path, threads=workers, score_threshold=AP_SCORE_THRESHOLD)
        with progress("pictures", len(samples)) as step:
            finds = run_detector(detector.detect, samples, shape, step)
        with progress("scores", 1) as step:
            report = score(finds, counting, fp_per_1000, on_progress=step)
        if out is not None:
            about = {
                "command": command_line(),
                "weights": f"{path} ({detector.model_hash})",
                "data": str(data),
            }
            write_report(out, report, finds, about)
        if as_json:
            typer.echo(json.dumps(report.as_json(), indent=1))
        else:
            console = Console()
            print_report(console, report)
            if out is not None:
                console.print(f"report: {out / 'report.md'}", soft_wrap=True)


def _fly_by(
    weights: Path,
    data: Path,
    plot: Path,
    target: Target,
    as_json: bool,
    workers: int | None,
    engine: str,
) -> None:
    if plot.suffix.lower() != ".png":
        raise EvaluationError(f"--fly-by {plot}: the picture's name must end in .png")
    frames = load_recording(data)
    detector = open_engine(engine, weights, threads=workers)
    with progress("frames", len(frames)) as step:
        run = fly_by(detector.detect, frames, target, step)
    write_file(plot, plot_fly_by(run, data.resolve().name))
    facts = run.as_json()
    if as_json:
        typer.echo(json.dumps(facts, indent=1))
    else:
        typer.echo(
            f"{plot}: {facts['frames']} frames, target in view in {facts['in_view']}, found in "
            f"{facts['found_in_view']} of these, in {facts['found_out_of_view']} without it"
        )


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[..., None]]:
    """A bar; what is given is called with the number done, and the total where that changes."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=progress_console) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done, of=total: bar.update(task, completed=done, total=of)


def print_report(console: Console, report: Report) -> None:
    """Show a report as tables of at most 80 columns; all intervals are in the written one."""
    for by, rows in report.groups.items():
        if not rows or (by is not By.CONDITION and len(rows) < 2):
            continue
        title = f"{TITLES[by]}; recall (95 %) and false positives at score {SCORE_THRESHOLD}"
        table = Table(title=escape(title), box=SIMPLE, padding=(0, 1, 0, 0))
        for name in ("", "what", "truths", "AP50", "AP50-95", "recall", "false/pic"):
            table.add_column(name, justify="left" if name in ("", "what") else "right")
        for name, row in rows.items():
            for what, s in row.items():
                shares = ["-" if x is None else f"{x.value:.3f}" for x in (s.ap50, s.ap50_95)]
                recall = escape(share_text(s.recall, SHORT))
                false = f"{s.false_per_picture:.4f}"
                table.add_row(name, what, str(s.truths), *shares, recall, false)
            table.add_section()
        console.print(table)
    text = operating_point_text(report.operating_point)
    console.print(f"{report.pictures} pictures; {text}", markup=False)
