"""How good a detector is: average precision, recall and false alarms, per level and condition.

A true box counts when enough of it is visible and it is not tiny; one that does not count is
neither missed nor, when found, a false alarm. The row ``candidate`` scores what is left after the
nesting check: that is what the localiser gets to see.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.sample import Sample
from edge_service.detector.engine import SCORE_THRESHOLD
from edge_service.detector.nms import pairwise_iou
from target_pose.candidate import Box, Candidate, Detections
from target_pose.nesting import group
from target_pose.target import Level, Target

Detect: TypeAlias = Callable[[NDArray[np.uint8]], Detections]

MIN_VISIBLE = 0.5
MIN_SIDE_PX = 8.0
IOU_STEPS = tuple(np.arange(0.5, 0.96, 0.05).round(2).tolist())
CANDIDATE = "candidate"
ALL = "all"


class Outcome(NamedTuple):
    """What was found of one kind in one picture; K found, M true."""

    scores: NDArray[np.float64]  # (K,), falling
    overlaps: NDArray[np.float32]  # (K, M)
    counts: NDArray[np.bool_]  # (M,)


@dataclass(frozen=True, slots=True)
class Scores:
    """One row of the report; None where there is nothing to find."""

    truths: int
    ap50: float | None
    ap50_95: float | None
    recall: float | None
    """At ``SCORE_THRESHOLD`` and IoU 0.5."""
    false_per_picture: float
    """Likewise."""


@dataclass(frozen=True, slots=True)
class Report:
    """Scores by condition (``all``, ``negative`` and the data set's own) and by level."""

    pictures: int
    rows: dict[str, dict[str, Scores]]

    def as_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "pictures": self.pictures,
            "score_threshold": SCORE_THRESHOLD,
            "rows": {c: {w: asdict(s) for w, s in r.items()} for c, r in self.rows.items()},
        }


def evaluate_detector(detect: Detect, samples: Iterable[Sample], target: Target) -> Report:
    """Run a detector over a data set and score it.

    Args:
        detect: Should return boxes down to a low score, else the AP is cut short.
        samples: Pictures and truth.
        target: For the nesting check.

    Raises:
        DatasetError: a picture cannot be read.
    """
    outcomes: dict[str, dict[str, list[Outcome]]] = {}
    pictures = 0
    for sample in samples:
        pictures += 1
        image = sample.read()
        detections = detect(image)
        found = {level.value: level_outcome(sample, detections, level) for level in Level}
        confident = Detections(
            {
                level: tuple(b for b in boxes if b.score > SCORE_THRESHOLD)
                for level, boxes in detections.boxes.items()
            }
        )
        found[CANDIDATE] = candidate_outcome(sample, group(confident, target, image))
        groups = [ALL, *sample.conditions]
        if sample.kind == "negative":
            groups.append(sample.kind)
        for condition in dict.fromkeys(groups):
            for what, outcome in found.items():
                outcomes.setdefault(condition, {}).setdefault(what, []).append(outcome)
    ordered = sorted(outcomes, key=lambda c: (c != ALL, c))
    rows = {c: {w: _scores(w, o) for w, o in outcomes[c].items()} for c in ordered}
    return Report(pictures, rows)


def average_precision(outcomes: list[Outcome], iou: float) -> float | None:
    """Area under the precision-recall curve (made monotonic) at one overlap; None without truths.

    The matching is greedy by falling score, each truth once (as in PASCAL VOC and COCO).
    """
    truths = sum(int(o.counts.sum()) for o in outcomes)
    if not truths:
        return None
    scores, hits = [np.zeros(0)], [np.zeros(0, bool)]
    for outcome in outcomes:
        hit, ignored = match(outcome, iou)
        scores.append(outcome.scores[~ignored])
        hits.append(hit[~ignored])
    order = np.argsort(-np.concatenate(scores), kind="stable")
    hit = np.concatenate(hits)[order]
    true_positives = np.cumsum(hit)
    precision = true_positives / np.arange(1, len(hit) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float(envelope[hit].sum() / truths)


def match(outcome: Outcome, iou: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which found boxes are true, and which hit only truths that do not count; (K,) each."""
    n_found, n_true = outcome.overlaps.shape
    hit, ignored = np.zeros(n_found, bool), np.zeros(n_found, bool)
    free = np.ones(n_true, bool)
    for k in range(n_found):
        near = outcome.overlaps[k] >= iou
        if (wanted := near & outcome.counts & free).any():
            free[np.argmax(np.where(wanted, outcome.overlaps[k], -1))] = False
            hit[k] = True
        elif (near & ~outcome.counts).any():
            ignored[k] = True
    return hit, ignored


def level_outcome(sample: Sample, detections: Detections, level: Level) -> Outcome:
    """What was found of one level in a picture."""
    boxes, counts = _truth(sample, level)
    found = detections.boxes.get(level, ())
    return Outcome(np.array([b.score for b in found]), pairwise_iou(_array(found), boxes), counts)


def candidate_outcome(sample: Sample, candidates: tuple[Candidate, ...]) -> Outcome:
    """What was found of whole targets: a candidate's overlap is that of its best level."""
    truths = {level: _truth(sample, level) for level in Level}
    n = min(len(boxes) for boxes, _ in truths.values())
    counts = np.zeros(n, bool)
    for _, level_counts in truths.values():
        counts |= level_counts[:n]
    overlaps = np.zeros((len(candidates), n), np.float32)
    for k, candidate in enumerate(candidates):
        for level, box in candidate.boxes.items():
            here = pairwise_iou(_array((box,)), truths[level][0][:n])[0]
            overlaps[k] = np.maximum(overlaps[k], here)
    return Outcome(np.array([c.score for c in candidates]), overlaps, counts)


def _truth(sample: Sample, level: Level) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    here = sample.classes == list(Level).index(level)
    boxes = sample.boxes[here]
    side = (boxes[:, 2:] - boxes[:, :2]).min(axis=1, initial=np.inf)
    return boxes, (sample.visible[here] >= MIN_VISIBLE) & (side >= MIN_SIDE_PX)


def _array(boxes: tuple[Box, ...]) -> NDArray[np.float32]:
    return np.array([(b.x0, b.y0, b.x1, b.y1) for b in boxes], np.float32).reshape(-1, 4)


def _scores(what: str, outcomes: list[Outcome]) -> Scores:
    truths = sum(int(o.counts.sum()) for o in outcomes)
    hits = false = 0
    for outcome in outcomes:
        hit, ignored = match(outcome, IOU_STEPS[0])
        # A candidate's score is a sum over its levels; it passed the threshold box by box
        above = outcome.scores > (0.0 if what == CANDIDATE else SCORE_THRESHOLD)
        hits += int((hit & above).sum())
        false += int((~hit & ~ignored & above).sum())
    curve = [average_precision(outcomes, iou) for iou in IOU_STEPS]
    known = [ap for ap in curve if ap is not None]
    return Scores(
        truths,
        curve[0],
        float(np.mean(known)) if known else None,
        hits / truths if truths else None,
        false / max(len(outcomes), 1),
    )
