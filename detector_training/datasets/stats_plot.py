"""The numbers of a data set as a figure for a report."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from detector_training.datasets.output import write_file
from detector_training.datasets.sample import CLASSES, Sample
from detector_training.datasets.stats import Stats, box_sides_px

COLOURS = {"T_good": "#2e9e4f", "T_better": "#1f77d0", "T_best": "#d0452f"}
_GREY = "#8a8a8a"
_BINS = 24


def plot_stats(stats: Stats, samples: Sequence[Sample], out: Path) -> None:
    """Draw conditions, sizes, distances and places of the targets; the format is by ``out``'s end.

    Raises:
        DatasetError: ``out`` cannot be written.
    """
    import matplotlib  # takes a second to load: only where a plot is drawn

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 2, figsize=(10, 7))
    _conditions(axes[0, 0], stats)
    _sizes(axes[0, 1], samples)
    _distances(axes[1, 0], samples)
    _places(axes[1, 1], samples)
    figure.suptitle(
        f"{stats.pictures} pictures, {stats.with_target} with a target, "
        f"{stats.negatives} without; {sum(stats.boxes.values())} boxes"
    )
    figure.tight_layout()
    file = io.BytesIO()
    try:
        figure.savefig(file, format=out.suffix[1:].lower() or "png", dpi=150)
    finally:
        pyplot.close(figure)
    write_file(out, file.getvalue())


def formats() -> tuple[str, ...]:
    """Ends of file names that a figure can be written as."""
    return (".pdf", ".png", ".svg")


def _conditions(axis: Any, stats: Stats) -> None:
    names = [name.replace("_", " ") for name in stats.conditions] + ["no target"]
    counts = [*stats.conditions.values(), stats.negatives]
    colours = ["#1f77d0"] * (len(names) - 2) + [_GREY] * 2
    bars = axis.barh(names[::-1], counts[::-1], color=colours[::-1])
    axis.bar_label(bars, padding=2, fontsize=8)
    axis.margins(x=0.12)
    axis.set(xlabel="pictures (one may show several)", title="Conditions")


def _sizes(axis: Any, samples: Sequence[Sample]) -> None:
    sides = box_sides_px(samples)
    axis.set(xlabel="longer side of the box [px]", ylabel="boxes", title="Sizes")
    if not sides.size:
        _nothing(axis, "no boxes")
        return
    classes = np.concatenate([s.classes for s in samples])
    bins = np.geomspace(max(float(sides.min()), 1.0), max(float(sides.max()), 2.0) * 1.01, _BINS)
    for k, name in enumerate(CLASSES):
        mine = sides[classes == k]
        label = f"{name} ({len(mine)})"
        axis.hist(mine, bins, histtype="step", linewidth=1.6, color=COLOURS[name], label=label)
    axis.set_xscale("log")
    axis.legend(fontsize=8)


def _distances(axis: Any, samples: Sequence[Sample]) -> None:
    distances = [s.distance_m for s in samples if s.distance_m is not None]
    axis.set(xlabel="distance to the target [m]", ylabel="pictures", title="Distances")
    if not distances:
        _nothing(axis, "the labels do not say")
        return
    axis.hist(distances, _BINS, color="#1f77d0")


def _places(axis: Any, samples: Sequence[Sample]) -> None:
    centres = [
        ((b[0] + b[2] + 1) / 2 / s.width, (b[1] + b[3] + 1) / 2 / s.height)
        for s in samples
        for b in s.boxes[:1]
    ]
    axis.set(xlabel="left to right", ylabel="bottom to top", title="Where the target stands")
    if not centres:
        _nothing(axis, "no boxes")
        return
    x, y = np.clip(np.array(centres), 0, 1).T
    axis.hist2d(x, 1 - y, bins=(16, 12), range=((0, 1), (0, 1)), cmap="Blues")


def _nothing(axis: Any, text: str) -> None:
    axis.text(0.5, 0.5, text, ha="center", va="center", color=_GREY, transform=axis.transAxes)
