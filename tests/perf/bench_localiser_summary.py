"""From trials to figures: medians with their intervals, calibration, flips, what is not covered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import binom, chi2

from detector_training.evaluation.intervals import Interval, wilson
from target_pose.localisation import Method
from tests.perf.bench_localiser_errors import DEGREES_OF_FREEDOM
from tests.perf.bench_localiser_trial import Trial

CALIBRATION_LEVELS = (0.50, 0.95, 0.99)
COVERED = 0.999
FLIP_DEG = 30.0
SURE_ROLL = ("edges", "gravity")


@dataclass(frozen=True)
class Spread:
    """Quantiles of one figure over the poses that have it."""

    count: int
    median: float
    low: float
    high: float
    """95 % confidence interval of the median, from order statistics."""
    p95: float


def spread(values: Iterable[float | None]) -> Spread | None:
    """Of the values that are there; None without any."""
    x = np.sort([v for v in values if v is not None])
    n = len(x)
    if not n:
        return None
    # the k-th smallest and k-th largest bracket the median with at least 95 %
    k = max(int(binom.ppf(0.025, n, 0.5)), 1)
    p95 = float(np.quantile(x, 0.95))
    return Spread(n, float(np.median(x)), float(x[k - 1]), float(x[n - k]), p95)


def is_flip(trial: Trial) -> bool:
    """Its normal is far off, and nothing said so: neither ``ambiguous`` nor the method."""
    return _is_far_off(trial) and trial.method != Method.BOX


def is_assumed_flip(trial: Trial) -> bool:
    """Its normal is far off, by the method that takes the board to face the camera."""
    return _is_far_off(trial) and trial.method == Method.BOX


def _is_far_off(trial: Trial) -> bool:
    return trial.normal_deg is not None and trial.normal_deg > FLIP_DEG and not trial.ambiguous


def is_covered(trial: Trial) -> bool:
    """Refused, not found, or with a covariance that holds its error at the level ``COVERED``."""
    if trial.squared is None:
        return True
    return trial.squared["pose"] <= float(chi2.ppf(COVERED, DEGREES_OF_FREEDOM["pose"]))


def cell_summary(trials: Sequence[Trial]) -> dict[str, Any]:
    """One cell by one way."""
    found = [t for t in trials if t.found]
    refused = Counter(t.refusal for t in found if t.refusal is not None)
    localised = [t for t in trials if t.localised]
    position = spread(t.position_mm for t in trials)
    normal = spread(t.normal_deg for t in trials)
    return {
        "condition": trials[0].condition,
        "distance_m": trials[0].distance_m,
        "poses": len(trials),
        "found": _share(len(found), len(trials)),
        "refused": _share(sum(refused.values()), len(found)),
        "reasons": dict(refused.most_common()),
        "ambiguous": _share(sum(t.ambiguous for t in localised), len(localised)),
        "methods": dict(Counter(t.method for t in localised if t.method).most_common()),
        "flips": sum(map(is_flip, localised)),
        "position_mm": position and asdict(position),
        "normal_deg": normal and asdict(normal),
    }


def by(trials: Iterable[Trial], key: Callable[[Trial], Any]) -> dict[Any, list[Trial]]:
    """Grouped, in order of first appearance."""
    groups: dict[Any, list[Trial]] = {}
    for trial in trials:
        groups.setdefault(key(trial), []).append(trial)
    return groups


def calibration(trials: Sequence[Trial], drawn: bool = False) -> dict[str, Any]:
    """Shares of squared Mahalanobis errors inside chi-square's levels, by part of the pose.

    Args:
        trials: Of any cells.
        drawn: With the camera whose calibration is off, not the exact one.
    """
    rows: dict[str, Any] = {}
    for part, freedom in DEGREES_OF_FREEDOM.items():
        squared = squared_errors(trials, part, drawn)
        rows[part] = {
            "count": len(squared),
            "inside": {
                f"{level:g}": _share(int((squared <= chi2.ppf(level, freedom)).sum()), len(squared))
                for level in CALIBRATION_LEVELS
            },
        }
    return rows


def squared_errors(trials: Sequence[Trial], part: str, drawn: bool = False) -> np.ndarray:
    """Squared Mahalanobis errors of the trials that have a pose; of the roll where it was seen."""
    errors = ((t, t.squared_drawn if drawn else t.squared) for t in trials)
    return np.array(
        [
            squared[part]
            for t, squared in errors
            if squared is not None and (part != "roll" or t.roll_source in SURE_ROLL)
        ]
    )


def paired(ours: Sequence[Trial], theirs: Sequence[Trial]) -> dict[str, Any]:
    """Both on the poses in which both have one, and who found what."""
    other = {t.index: t for t in theirs}
    pairs = [(t, other[t.index]) for t in ours if t.index in other]
    both = [(a, b) for a, b in pairs if a.localised and b.localised]
    row: dict[str, Any] = {
        "poses": len(pairs),
        "both": len(both),
        "we_alone": sum(a.localised and not b.localised for a, b in pairs),
        "they_alone": sum(b.localised and not a.localised for a, b in pairs),
    }
    for figure in ("position_mm", "normal_deg"):
        mine = spread(getattr(a, figure) for a, _ in both)
        their = spread(getattr(b, figure) for _, b in both)
        row[figure] = {"ours": mine and asdict(mine), "theirs": their and asdict(their)}
    return row


def _share(hits: int, trials: int) -> dict[str, float] | None:
    share: Interval | None = wilson(hits, trials)
    return share and share._asdict()
