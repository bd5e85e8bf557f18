"""The log of a run: one line of CSV a step, readable while it grows."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from detector_training.datasets.output import write_file
from detector_training.errors import TrainingError
from detector_training.training.loss import Loss
from detector_training.training.state import State
from detector_training.training.validation import ValScore

VAL_FIELDS = tuple(f"val_{name}" for name in ValScore._fields)
LOG_FIELDS = (
    "step",
    "images",
    "elapsed_s",
    "learning_rate",
    "loss",
    "score_loss",
    "box_loss",
    *VAL_FIELDS,
)


def trim_log(path: Path, step: int) -> None:
    """Drop the lines after the checkpoint: those steps will be done again.

    Raises:
        TrainingError: it cannot be written, or is no log of a run.
    """
    rows: list[dict[str, str]] = []
    if path.exists():
        try:
            with path.open(newline="") as file:
                rows = [r for r in csv.DictReader(file) if r["loss"] and int(r["step"]) <= step]
        except (OSError, KeyError, ValueError, TypeError, csv.Error) as error:
            raise TrainingError(
                f"{path} is no log of a run ({type(error).__name__}: {error}); name another folder"
            ) from None
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, LOG_FIELDS, extrasaction="ignore", restval="")
    writer.writeheader()
    writer.writerows(rows)
    write_file(path, text.getvalue())


def append_log(path: Path, state: State, rate: float, loss: Loss, val: ValScore | None) -> None:
    """Add a step.

    Raises:
        TrainingError: it cannot be written.
    """
    scores = [""] * len(VAL_FIELDS) if val is None else [f"{v:.5g}" for v in val]
    row = (
        state.step,
        state.images,
        f"{state.elapsed_s:.1f}",
        f"{rate:.6g}",
        *(f"{float(part):.5g}" for part in loss),
        *scores,
    )
    try:
        with path.open("a", newline="") as file:
            csv.writer(file).writerow(row)
    except OSError as error:
        raise TrainingError(f"cannot write {path}: {error.strerror or error}") from None
