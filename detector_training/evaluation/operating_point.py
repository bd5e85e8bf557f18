"""Recall at a false positive rate that one can live with: the threshold that gives it is found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector_training.evaluation.intervals import Interval, upper_bound, wilson
from detector_training.evaluation.matching import Outcome, match


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """A threshold on the candidates' scores and what it costs."""

    allowed_per_1000: float
    threshold: float
    """Least score above which the rate of false positives is as allowed."""
    recall: Interval | None
    """Of the truths that count; None where there are none."""
    false_positives: int
    pictures: int
    """In which false positives were looked for."""
    upper_bound_per_1000: float
    """With 95 % confidence the rate is below; far above the allowed one when pictures are few."""


def at_false_positive_rate(
    positives: Sequence[Outcome], searched: Sequence[Outcome], allowed_per_1000: float
) -> OperatingPoint:
    """The lowest threshold with at most that many false positives, and the recall there.

    Args:
        positives: Outcomes of the pictures whose recall is asked for.
        searched: Outcomes of the pictures in which false positives count.
        allowed_per_1000: Mean number in 1000 pictures; one false box more in a picture counts one.

    Raises:
        ValueError: there are no pictures, or the rate is negative.
    """
    if not searched or not allowed_per_1000 >= 0:
        raise ValueError(f"{allowed_per_1000} per 1000 in {len(searched)} pictures")
    false = np.sort(np.concatenate([_false_scores(o) for o in searched]))[::-1]
    allowed = int(np.floor(allowed_per_1000 * len(searched) / 1000 + 1e-9))
    threshold = float(false[allowed]) if len(false) > allowed else 0.0
    false_positives = int((false > threshold).sum())
    hits = truths = 0
    for outcome in positives:
        hit, _, _ = match(outcome)
        hits += int((hit & (outcome.scores > threshold)).sum())
        truths += int(outcome.counts.sum())
    return OperatingPoint(
        allowed_per_1000,
        threshold,
        wilson(hits, truths),
        false_positives,
        len(searched),
        1000 * upper_bound(false_positives, len(searched)),
    )


def _false_scores(outcome: Outcome) -> NDArray[np.float64]:
    hit, ignored, _ = match(outcome)
    return np.asarray(outcome.scores[~hit & ~ignored])
