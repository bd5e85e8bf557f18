"""Runs of a net of width 4 on small crops: seconds each."""

from __future__ import annotations

import csv

from detector_training.training import batches
from detector_training.training.loop import LOG

SIZE = (160, 128)
TINY = {
    "width": 4,
    "batch_pixels": 2 * SIZE[0] * SIZE[1],
    "bfloat16": False,
    "checkpoint_steps": 2,
}


def use_small_crops(patch=setattr):
    """The real sizes would take most of the tests' time and show nothing more."""
    patch(batches, "SIZES", (SIZE,))
    patch(batches, "SIZE_SHARES", (1.0,))


def log_rows(run):
    """The lines of a run's log."""
    with (run / LOG).open(newline="") as file:
        return list(csv.DictReader(file))
