"""Precision and recall over all thresholds, and how much another set of pictures would move them.

The bootstrap draws pictures, not boxes, since the boxes of one picture hang together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector_training.evaluation.intervals import Interval
from detector_training.evaluation.matching import Outcome, match

IOU_STEPS = tuple(np.arange(0.5, 0.96, 0.05).round(2).tolist())
RESAMPLES = 200
"""Draws of the bootstrap: its 95 % ends move by some percent of the interval's length."""
_CHUNK = 200_000
"""Numbers in one go: they stay in the processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Ranking:
    """All that was found at one overlap, best first (K), without what hit ignored truths."""

    scores: NDArray[np.float64]  # (K,)
    hits: NDArray[np.bool_]  # (K,)
    pictures: NDArray[np.intp]  # (K,)
    truths: NDArray[np.int64]  # (P,)
    """Number that counts, of each picture."""

    @property
    def precision(self) -> NDArray[np.float64]:
        """(K,), as the list grows, not made monotonic."""
        return np.asarray(np.cumsum(self.hits) / np.arange(1, len(self.hits) + 1))

    @property
    def recall(self) -> NDArray[np.float64]:
        """(K,), as the list grows; zeros where nothing is true."""
        return np.asarray(np.cumsum(self.hits) / max(int(self.truths.sum()), 1))

    def envelope(self) -> NDArray[np.float64]:
        """Precision (K,) made monotonic: the best at this recall or a higher one."""
        return np.asarray(np.maximum.accumulate(self.precision[::-1])[::-1])

    def of(self, pictures: Sequence[int]) -> Ranking:
        """The same of some pictures."""
        place = np.full(len(self.truths), -1, np.intp)
        place[list(pictures)] = np.arange(len(pictures))
        here = place[self.pictures] >= 0
        return Ranking(
            self.scores[here],
            self.hits[here],
            place[self.pictures[here]],
            self.truths[list(pictures)],
        )


def rank(outcomes: Sequence[Outcome], iou: float) -> Ranking:
    """Put what was found in all pictures in one order."""
    scores, hits, pictures = [np.zeros(0)], [np.zeros(0, bool)], [np.zeros(0, np.intp)]
    for k, outcome in enumerate(outcomes):
        hit, ignored, _ = match(outcome, iou)
        scores.append(outcome.scores[~ignored])
        hits.append(hit[~ignored])
        pictures.append(np.full(int((~ignored).sum()), k, np.intp))
    all_scores = np.concatenate(scores)
    order = np.argsort(-all_scores, kind="stable")
    truths = np.array([int(o.counts.sum()) for o in outcomes], np.int64)
    return Ranking(
        all_scores[order], np.concatenate(hits)[order], np.concatenate(pictures)[order], truths
    )


def average_precision(outcomes: Sequence[Outcome], iou: float) -> float | None:
    """Area under the precision-recall curve (made monotonic) at one overlap; None without truths.

    The matching is greedy by falling score, each truth once (as in PASCAL VOC and COCO).
    """
    ranking = rank(outcomes, iou)
    if not (truths := int(ranking.truths.sum())):
        return None
    return float(ranking.envelope()[ranking.hits].sum() / truths)


def draw_pictures(pictures: int, seed: int, resamples: int = RESAMPLES) -> NDArray[np.int64]:
    """How often each draw of the bootstrap takes each picture, (resamples, pictures)."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(pictures, np.full(pictures, 1 / pictures), resamples)


def resampled_precision(ranking: Ranking, draws: NDArray[np.int64]) -> NDArray[np.float64]:
    """Average precision (B,) of each draw (B, P); nan where a draw holds nothing true.

    A picture drawn twice is two pictures whose boxes stand beside each other in the order.
    """
    result = np.full(len(draws), np.nan)
    truths, small = draws @ ranking.truths, draws.astype(np.int32)
    step = max(1, _CHUNK // max(len(ranking.hits), 1))
    for start in range(0, len(draws), step):
        here = slice(start, start + step)
        weight = small[here][:, ranking.pictures]  # (b, K)
        # Precision is highest at a hit, so that the rest of the curve need not be made monotonic
        true, found = weight[:, ranking.hits], np.cumsum(weight, axis=1, dtype=np.int32)
        precision = np.cumsum(true, axis=1) / np.maximum(found[:, ranking.hits], 1)
        envelope = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        area = (envelope * true).sum(axis=1)
        some = truths[here] > 0
        result[here][some] = area[some] / truths[here][some]
    return result


def rank_at_all(outcomes: Sequence[Outcome]) -> tuple[Ranking, ...]:
    """One ranking for each of ``IOU_STEPS``; the matching is done here, once for all groups."""
    return tuple(rank(outcomes, iou) for iou in IOU_STEPS)


def precision_intervals(
    rankings: Sequence[Ranking], seed: int, resamples: int = RESAMPLES
) -> tuple[Interval | None, Interval | None]:
    """AP50 and AP50-95, each with the bootstrap's interval; None where nothing is true.

    Args:
        rankings: One for each of ``IOU_STEPS``, of the same pictures.
        seed: Of the draws, which are the same at all overlaps.
        resamples: Number of draws.
    """
    truths = rankings[0].truths
    if not truths.any():
        return None, None
    draws = draw_pictures(len(truths), seed, resamples)
    values = [float(r.envelope()[r.hits].sum() / truths.sum()) for r in rankings]
    spreads = [resampled_precision(r, draws) for r in rankings]
    return (
        _interval(values[0], spreads[0]),
        _interval(float(np.mean(values)), np.mean(spreads, axis=0)),
    )


def _interval(value: float, spread: NDArray[np.float64]) -> Interval:
    known = spread[np.isfinite(spread)]
    if not len(known):
        return Interval(value, 0.0, 1.0)
    low, high = np.quantile(known, (0.025, 0.975)).tolist()
    return Interval(value, min(low, value), max(high, value))
