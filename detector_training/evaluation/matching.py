"""What was found against what is true: greedy by falling score, each truth once.

A true box counts when enough of it is visible and the board is not tiny; one that does not count
is neither missed nor, when found, a false alarm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.sample import Sample
from detector_training.errors import EvaluationError
from edge_service.detector.nms import pairwise_iou
from target_pose.candidate import Box, Candidate, Detections
from target_pose.target import Level

MIN_VISIBLE = 0.5
MIN_PX = 14.0
HIT_IOU = 0.5


@dataclass(frozen=True, slots=True)
class Counting:
    """Which truths a detector has to find.

    Raises:
        EvaluationError: a number is out of bounds.
    """

    min_px: float = MIN_PX
    """Least width of the target's widest box; the inner levels count with it."""
    min_visible: float = MIN_VISIBLE
    """Least visible share of a level's shape."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.min_px) and self.min_px >= 0):
            raise EvaluationError(f"--min-px {self.min_px}: give a width in pixels, 0 or more")
        if not 0 <= self.min_visible <= 1:
            raise EvaluationError(f"--min-visible {self.min_visible}: give a share in [0, 1]")


class Outcome(NamedTuple):
    """What was found of one kind in one picture; K found, M true."""

    scores: NDArray[np.float64]  # (K,), falling
    overlaps: NDArray[np.float32]  # (K, M)
    counts: NDArray[np.bool_]  # (M,)


def match(
    outcome: Outcome, iou: float = HIT_IOU
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.intp]]:
    """Greedy matching at one overlap.

    Returns:
        Which found boxes are true (K,), which hit only truths that do not count (K,), and which
        truth each true one took (K,), -1 for none.
    """
    n_found, n_true = outcome.overlaps.shape
    hit, ignored = np.zeros(n_found, bool), np.zeros(n_found, bool)
    taken = np.full(n_found, -1, np.intp)
    free = np.ones(n_true, bool)
    if not (outcome.overlaps >= iou).any():  # most pictures at the high overlaps
        return hit, ignored, taken
    for k in range(n_found):
        near = outcome.overlaps[k] >= iou
        if (wanted := near & outcome.counts & free).any():
            taken[k] = np.argmax(np.where(wanted, outcome.overlaps[k], -1))
            free[taken[k]] = False
            hit[k] = True
        elif (near & ~outcome.counts).any():
            ignored[k] = True
    return hit, ignored, taken


def level_outcome(
    sample: Sample, detections: Detections, level: Level, counting: Counting
) -> Outcome:
    """What was found of one level in a picture."""
    boxes, counts = _truth(sample, level, counting)
    found = detections.boxes.get(level, ())
    return Outcome(
        np.array([b.score for b in found], np.float64), pairwise_iou(as_array(found), boxes), counts
    )


def candidate_outcome(
    sample: Sample, candidates: tuple[Candidate, ...], counting: Counting
) -> Outcome:
    """What was found of whole targets: a candidate's overlap is that of its best level."""
    targets = true_targets(sample)
    found = [(_wide_enough(sample, i, counting), i) for i in targets]
    counts = np.array(
        [wide and bool((sample.visible[i] >= counting.min_visible).any()) for wide, i in found],
        bool,
    )
    overlaps = np.zeros((len(candidates), len(targets)), np.float32)
    for k, candidate in enumerate(candidates):
        for m, indices in enumerate(targets):
            for i in indices:
                if (box := candidate.boxes.get(list(Level)[sample.classes[i]])) is not None:
                    here = pairwise_iou(as_array((box,)), sample.boxes[i][None])[0, 0]
                    overlaps[k, m] = max(overlaps[k, m], here)
    return Outcome(np.array([c.score for c in candidates], np.float64), overlaps, counts)


def board_px(sample: Sample) -> float | None:
    """Width of the widest true box of a picture: the board's, where it is labelled; else None."""
    return float((sample.boxes[:, 2] - sample.boxes[:, 0]).max()) if len(sample.boxes) else None


def as_array(boxes: tuple[Box, ...]) -> NDArray[np.float32]:
    """Boxes as (K, 4)."""
    return np.array([(b.x0, b.y0, b.x1, b.y1) for b in boxes], np.float32).reshape(-1, 4)


def true_targets(sample: Sample) -> list[list[int]]:
    """The labelled boxes of each target, as indices into ``sample.boxes``, its widest first.

    A box belongs to the widest one around its centre, unless that has one of its level already.
    """
    sides = sample.boxes[:, 2:] - sample.boxes[:, :2]
    targets: list[list[int]] = []
    for i in np.argsort(-sides.prod(axis=1), kind="stable").tolist():
        centre = (sample.boxes[i, :2] + sample.boxes[i, 2:]) / 2
        for indices in targets:
            x0, y0, x1, y1 = sample.boxes[indices[0]]
            around = x0 <= centre[0] <= x1 and y0 <= centre[1] <= y1
            if around and sample.classes[i] not in sample.classes[indices]:
                indices.append(i)
                break
        else:
            targets.append([i])
    return targets


def _wide_enough(sample: Sample, indices: list[int], counting: Counting) -> bool:
    box = sample.boxes[indices[0]]
    return float(box[2] - box[0]) >= counting.min_px


def _truth(
    sample: Sample, level: Level, counting: Counting
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    wide = np.zeros(len(sample.boxes), bool)
    for indices in true_targets(sample):
        wide[indices] = _wide_enough(sample, indices, counting)
    here = sample.classes == list(Level).index(level)
    return sample.boxes[here], ((sample.visible >= counting.min_visible) & wide)[here]
