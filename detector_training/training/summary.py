"""What a data set teaches, in one line, before hours are spent on it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from detector_training.datasets.sample import CLASSES, Sample
from detector_training.errors import TrainingError
from detector_training.training.augment import MAX_SCALE, MIN_SIDE_PX, MIN_VISIBLE


@dataclass(frozen=True, slots=True)
class Summary:
    """Numbers of a training set."""

    pictures: int
    negatives: int
    """Pictures without a box."""
    boxes: dict[str, int]
    """By level, those that are taught at some scale."""
    ignored: int
    """Boxes neither taught nor punished at any scale: too small, or too little to be seen."""

    @property
    def missing(self) -> tuple[str, ...]:
        """Levels without a box: a net unlearns them."""
        return tuple(name for name, count in self.boxes.items() if not count)

    def __str__(self) -> str:
        total = sum(self.boxes.values()) + self.ignored
        share = self.ignored / total if total else 0.0
        levels = ", ".join(f"{count} {name}" for name, count in self.boxes.items())
        return (
            f"{self.pictures} pictures to train on: {levels}; "
            f"{self.negatives} without a target, {share:.1%} of the boxes ignored"
        )


def count_boxes(samples: Sequence[Sample]) -> Summary:
    """Count what is taught; no picture is read."""
    boxes = dict.fromkeys(CLASSES, 0)
    ignored = 0
    for sample in samples:
        side = (sample.boxes[:, 2:] - sample.boxes[:, :2]).min(axis=1, initial=np.inf)
        taught = (sample.visible >= MIN_VISIBLE) & (side * MAX_SCALE >= MIN_SIDE_PX)
        ignored += int((~taught).sum())
        for index in sample.classes[taught].tolist():
            boxes[CLASSES[index]] += 1
    return Summary(len(samples), sum(not len(s.boxes) for s in samples), boxes, ignored)


def summarise(samples: Sequence[Sample]) -> Summary:
    """The same of a training set.

    Raises:
        TrainingError: no box counts, so that nothing can be learned.
    """
    summary = count_boxes(samples)
    if not any(summary.boxes.values()):
        raise TrainingError(
            f"no box to learn from in {len(samples)} pictures ({summary.ignored} are narrower than "
            f"{MIN_SIDE_PX / MAX_SCALE:.1f} px or less than {MIN_VISIBLE:.0%} visible); "
            "look at them with `dataset check --sheet`"
        )
    return summary


def fingerprint(samples: Sequence[Sample]) -> str:
    """Digest of the labels and the pictures' names: a resumed run must see the same."""
    digest = hashlib.sha256()
    for s in samples:
        digest.update(f"{s.image.name} {s.width} {s.height}\n".encode(errors="surrogateescape"))
        for values in (s.boxes, s.classes, s.visible):
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
