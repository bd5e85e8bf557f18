"""The curves of a run as a picture: losses, scores on the validation set, learning rate."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from detector_training.datasets.output import write_file
from detector_training.training.validation import ValScore


def plot_log(log: Path, out: Path, window: int = 50) -> None:
    """Draw the columns of a training log, the losses smoothed over at most ``window`` steps.

    Raises:
        DatasetError: the picture cannot be written.
    """
    import matplotlib  # takes a second to load: only where a plot is drawn

    matplotlib.use("Agg")
    from matplotlib import pyplot

    with log.open(newline="") as file:
        rows = list(csv.DictReader(file))
    scored = [r for r in rows if r.get("val_ap50_95")]
    figure, axes = pyplot.subplots(1, 3 if scored else 2, figsize=(15 if scored else 10, 4))
    pictures = np.array([int(r["images"]) for r in rows])
    n = max(min(window, len(rows) // 5), 1)
    for name in ("loss", "score_loss", "box_loss"):
        values = np.array([float(r[name]) for r in rows])
        if len(values):
            smooth = np.convolve(values, np.ones(n) / n, "valid")
            axes[0].plot(pictures[n - 1 :], smooth, label=name)
    axes[0].set(xlabel="pictures seen", ylabel=f"mean of {n} steps", yscale="log")
    axes[0].legend()
    axes[1].plot(pictures, [float(r["learning_rate"]) for r in rows])
    axes[1].set(xlabel="pictures seen", ylabel="learning rate")
    if scored:
        at = [int(r["images"]) for r in scored]
        for field in ValScore._fields:
            axes[2].plot(at, [float(r[f"val_{field}"]) for r in scored], "o-", label=field)
        best = max(scored, key=lambda r: (float(r["val_ap50_95"]), int(r["images"])))
        axes[2].axvline(int(best["images"]), color="gray", linestyle=":", label="weights kept")
        axes[2].set(xlabel="pictures seen", ylabel="on the validation set")
        axes[2].legend()
    figure.tight_layout()
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=100)
    pyplot.close(figure)
    write_file(out, data.getvalue())
