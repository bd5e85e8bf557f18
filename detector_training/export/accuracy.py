"""What int8 costs: the same data set through both files, per level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from detector_training.datasets.sample import Sample
from detector_training.evaluation.scores import CANDIDATE, evaluate_detector
from edge_service.detector.engines import open_engine
from target_pose.target import Target

SCORE_THRESHOLD = 0.02
"""Low, so that the precision-recall curve is whole."""


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Of one file on one data set, by level and for whole targets; None: nothing to find."""

    ap50: dict[str, float | None]
    recall: dict[str, float | None]
    false_per_picture: float


def measure(
    runtime: str, path: Path, threads: int, samples: Sequence[Sample], target: Target
) -> Accuracy:
    """Score an ONNX file; for ``apart``."""
    detector = open_engine(runtime, path, threads=threads, score_threshold=SCORE_THRESHOLD)
    rows = evaluate_detector(detector.detect, samples, target).rows["all"]
    return Accuracy(
        {what: None if s.ap50 is None else s.ap50.value for what, s in rows.items()},
        {what: None if s.recall is None else s.recall.value for what, s in rows.items()},
        rows[CANDIDATE].false_per_picture,
    )


def worst_loss(before: Accuracy, after: Accuracy) -> float:
    """The largest fall of any AP50 or recall."""
    falls = [0.0]
    for was, now in ((before.ap50, after.ap50), (before.recall, after.recall)):
        falls += [v - (now[k] or 0.0) for k, v in was.items() if v is not None]
    return max(falls)
