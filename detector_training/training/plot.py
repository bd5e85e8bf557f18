"""The loss curve of a run as a picture."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np


def plot_log(log: Path, out: Path, window: int = 50) -> None:
    """Draw the columns of a training log, smoothed over ``window`` steps."""
    import matplotlib  # takes a second to load: only where a plot is drawn

    matplotlib.use("Agg")
    from matplotlib import pyplot

    with log.open(newline="") as file:
        rows = list(csv.DictReader(file))
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 4))
    pictures = np.array([int(r["images"]) for r in rows])
    for name in ("loss", "score_loss", "box_loss"):
        values = np.array([float(r[name]) for r in rows])
        n = min(window, max(len(values), 1))
        if len(values):
            smooth = np.convolve(values, np.ones(n) / n, "valid")
            left.plot(pictures[n - 1 :], smooth, label=name)
    left.set(xlabel="pictures seen", ylabel=f"mean of {window} steps", yscale="log")
    left.legend()
    right.plot(pictures, [float(r["learning_rate"]) for r in rows])
    right.set(xlabel="pictures seen", ylabel="learning rate")
    figure.tight_layout()
    figure.savefig(out, dpi=100)
    pyplot.close(figure)
