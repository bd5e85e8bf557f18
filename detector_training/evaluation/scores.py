"""How good a detector is: average precision, recall and false alarms, per level and per group.

The row ``candidate`` scores what is left after the nesting check: what the localiser gets to see.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from detector_training.datasets.sample import Sample
from detector_training.evaluation.groups import ALL, By, groups
from detector_training.evaluation.intervals import Interval, wilson
from detector_training.evaluation.matching import (
    Counting,
    Outcome,
    candidate_outcome,
    level_outcome,
)
from detector_training.evaluation.operating_point import OperatingPoint, at_false_positive_rate
from detector_training.evaluation.precision_recall import (
    RESAMPLES,
    Ranking,
    precision_intervals,
    rank_at_all,
)
from detector_training.evaluation.run import Detect, Find, run_detector
from edge_service.detector.detector import SCORE_THRESHOLD
from target_pose.target import Level, Target

CANDIDATE = "candidate"
BOOTSTRAP_SEED = 0


@dataclass(frozen=True, slots=True)
class Scores:
    """One row of the report; None where there is nothing to find."""

    pictures: int
    truths: int
    ap50: Interval | None
    ap50_95: Interval | None
    recall: Interval | None
    """At ``SCORE_THRESHOLD`` and IoU 0.5."""
    false_per_picture: float
    """Likewise."""
    pictures_with_false: Interval
    """Share of them, likewise."""


@dataclass(frozen=True, slots=True)
class Report:
    """Scores by group and by level."""

    pictures: int
    counting: Counting
    groups: dict[By, dict[str, dict[str, Scores]]]
    operating_point: OperatingPoint
    """Of the candidates, over all pictures."""

    @property
    def rows(self) -> dict[str, dict[str, Scores]]:
        """Scores by condition: ``all``, ``negative`` and the data set's own."""
        return self.groups[By.CONDITION]

    def as_json(self) -> dict[str, Any]:
        """The same as plain values; an interval has ``value low high``."""
        return {
            "pictures": self.pictures,
            "score_threshold": SCORE_THRESHOLD,
            "counting": asdict(self.counting),
            "confidence": 0.95,
            "operating_point": _plain(self.operating_point),
            "rows": _plain_rows(self.rows),
            **{
                f"by_{by}": _plain_rows(rows)
                for by, rows in self.groups.items()
                if by is not By.CONDITION
            },
        }


def evaluate_detector(detect: Detect, samples: Iterable[Sample], target: Target) -> Report:
    """Run a detector over a data set and score it with the usual settings.

    Raises:
        DatasetError: a picture cannot be read.
    """
    return score(run_detector(detect, samples, target))


def score(
    finds: Sequence[Find],
    counting: Counting | None = None,
    allowed_per_1000: float = 1.0,
    resamples: int = RESAMPLES,
    on_progress: Callable[[int, int], None] = lambda done, of: None,
) -> Report:
    """Score what a detector found.

    Args:
        finds: One for each picture.
        counting: Which truths have to be found.
        allowed_per_1000: False positives in 1000 pictures at the operating point.
        resamples: Draws of the bootstrap.
        on_progress: Called with the number of groups done, and of all.
    """
    counting = counting or Counting()
    outcomes = outcomes_of(finds, counting)
    rankings = {what: rank_at_all(one) for what, one in outcomes.items()}
    grouped = groups([f.sample for f in finds])
    total, done = sum(len(rows) for rows in grouped.values()), 0
    scored: dict[By, dict[str, dict[str, Scores]]] = {by: {} for by in By}
    for by, names in grouped.items():
        for name, indices in names.items():
            scored[by][name] = {
                what: score_row(what, [r.of(indices) for r in ranked], resamples)
                for what, ranked in rankings.items()
            }
            done += 1
            on_progress(done, total)
    point = at_false_positive_rate(outcomes[CANDIDATE], outcomes[CANDIDATE], allowed_per_1000)
    return Report(len(finds), counting, scored, point)


def outcomes_of(finds: Sequence[Find], counting: Counting) -> dict[str, list[Outcome]]:
    """What was found of each level and of whole targets, in every picture."""
    found = {
        level.value: [level_outcome(f.sample, f.detections, level, counting) for f in finds]
        for level in Level
    }
    found[CANDIDATE] = [candidate_outcome(f.sample, f.candidates, counting) for f in finds]
    return found


def threshold_of(what: str) -> float:
    """From which score on something counts as found.

    A candidate's score is a sum over its levels; it passed the threshold box by box.
    """
    return 0.0 if what == CANDIDATE else SCORE_THRESHOLD


def score_row(what: str, rankings: Sequence[Ranking], resamples: int = RESAMPLES) -> Scores:
    """The scores of one level, or of candidates, in some pictures; at least one.

    Args:
        what: A level or ``CANDIDATE``.
        rankings: One for each of ``IOU_STEPS``.
        resamples: Draws of the bootstrap.
    """
    first = rankings[0]
    pictures, truths = len(first.truths), int(first.truths.sum())
    above = first.scores > threshold_of(what)
    false = ~first.hits & above
    ap50, ap50_95 = precision_intervals(rankings, BOOTSTRAP_SEED, resamples)
    share = wilson(len(np.unique(first.pictures[false])), pictures)
    assert share is not None
    return Scores(
        pictures,
        truths,
        ap50,
        ap50_95,
        wilson(int((first.hits & above).sum()), truths),
        int(false.sum()) / pictures,
        share,
    )


def _plain_rows(rows: Mapping[str, Mapping[str, Scores]]) -> dict[str, Any]:
    return {name: {what: _plain(s) for what, s in row.items()} for name, row in rows.items()}


def _plain(value: Scores | OperatingPoint) -> dict[str, Any]:
    return {
        name: x._asdict() if isinstance(x, Interval) else x
        for name, x in ((n, getattr(value, n)) for n in value.__dataclass_fields__)
    }


__all__ = [
    "ALL",
    "CANDIDATE",
    "Report",
    "Scores",
    "evaluate_detector",
    "outcomes_of",
    "score",
    "score_row",
]
