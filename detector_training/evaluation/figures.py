"""The figures of an evaluation, as PNG bytes."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from detector_training.evaluation.groups import ALL, By
from detector_training.evaluation.matching import HIT_IOU, Outcome
from detector_training.evaluation.precision_recall import rank
from detector_training.evaluation.scores import CANDIDATE, Report

WIDTHS = {"T_good": 4.5, "T_better": 2.8, "T_best": 1.2}
"""Of lines that may lie on each other."""
COLOURS = {"T_good": "#2e9e4f", "T_better": "#1f77d0", "T_best": "#d0452f", CANDIDATE: "#202020"}


@contextmanager
def figure(size: tuple[float, float]) -> Iterator[tuple[Any, Any, io.BytesIO]]:
    """A figure, its one axis and the file it is saved to at the end; size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import
    from matplotlib.figure import Figure

    drawn = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(drawn)
    file = io.BytesIO()
    yield drawn, drawn.subplots(), file
    drawn.savefig(file, format="png", dpi=130)


def pr_curves(outcomes: Mapping[str, Sequence[Outcome]], report: Report) -> bytes:
    """Precision over recall at IoU 0.5, each level and the candidates."""
    with figure((7, 5)) as (_, axis, file):
        for what, one in outcomes.items():
            ranking = rank(one, HIT_IOU)
            ap = report.rows[ALL][what].ap50
            if ap is None:
                continue
            label = f"{what}: AP50 {ap.value:.3f} [{ap.low:.3f}, {ap.high:.3f}]"
            recall = np.concatenate([[0.0], ranking.recall])
            precision = np.concatenate([[1.0], ranking.precision])
            axis.plot(recall, precision, color=COLOURS[what], label=label, linewidth=1.4)
        axis.set(xlim=(0, 1.01), ylim=(0, 1.02), xlabel="recall", ylabel="precision")
        axis.set_title(f"{report.pictures} pictures, IoU {HIT_IOU:g}; candidates after nesting")
        axis.grid(alpha=0.3)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="lower left", fontsize=8)
    return file.getvalue()


def recall_by(report: Report, by: By) -> bytes:
    """Recall of the levels and the candidates in each bin, with 95 % intervals."""
    rows = report.groups[by]
    unit = "distance [m]" if by is By.DISTANCE else "width of the board [px]"
    with figure((8, 4.5)) as (_, axis, file):
        for k, (what, colour) in enumerate(COLOURS.items()):
            points = [
                (n + 0.12 * (k - 1.5), row[what].recall)
                for n, row in enumerate(rows.values())
                if row[what].recall is not None
            ]
            x = np.array([p[0] for p in points])
            y = np.array([p[1] for p in points], float).reshape(-1, 3)
            spread = np.abs(y[:, 1:].T - y[:, 0])
            axis.errorbar(x, y[:, 0], spread, fmt="o-", color=colour, label=what, capsize=2, ms=4)
        names = [f"{name}\n{row[CANDIDATE].truths} targets" for name, row in rows.items()]
        axis.set_xticks(range(len(rows)), names, fontsize=8)
        axis.set(ylim=(0, 1.03), xlabel=unit, ylabel="recall")
        axis.set_title("Recall at the engine's threshold, 95 % intervals")
        axis.grid(alpha=0.3)
        if rows:
            axis.legend(fontsize=8)
        else:
            axis.text(0.5, 0.5, "the labels do not say", ha="center", transform=axis.transAxes)
    return file.getvalue()
