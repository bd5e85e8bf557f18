"""Numbers of a data set: pictures, boxes and their sizes, distances, and the eight conditions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detector_training.datasets.conditions import PAPER_CONDITIONS, paper_conditions
from detector_training.datasets.sample import CLASSES, Sample

NONE_NOTED = "none of these"
SPLIT_UNKNOWN = "not said"


@dataclass(frozen=True, slots=True)
class Spread:
    """How values spread."""

    count: int
    least: float
    p10: float
    median: float
    p90: float
    most: float


@dataclass(frozen=True, slots=True)
class Stats:
    """Numbers of a data set."""

    pictures: int
    with_target: int
    negatives: int
    picture_sizes: dict[str, int]
    """Number of pictures by ``WIDTHxHEIGHT``."""
    boxes: dict[str, int]
    """By level."""
    box_side_px: dict[str, Spread | None]
    """Longer side of the boxes, by level."""
    cut: int
    """Boxes of which under 90 % are to be seen."""
    distance_m: Spread | None
    conditions: dict[str, int]
    """Pictures with a target by the paper's conditions; one may show several."""
    noted: dict[str, int]
    """Pictures by what is noted, in the data set's own words."""
    splits: dict[str, int]

    def as_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return asdict(self)


def dataset_stats(samples: Sequence[Sample]) -> Stats:
    """Count a data set; no picture is read."""
    classes = np.concatenate([s.classes for s in samples] or [np.zeros(0, np.int64)])
    sides = box_sides_px(samples)
    visible = np.concatenate([s.visible for s in samples] or [np.zeros(0, np.float32)])
    shown = [paper_conditions(s.conditions) for s in samples if len(s.boxes)]
    conditions = Counter(c for names in shown for c in names)
    distances = [s.distance_m for s in samples if s.distance_m is not None]
    return Stats(
        len(samples),
        len(shown),
        len(samples) - len(shown),
        dict(Counter(f"{s.width}x{s.height}" for s in samples).most_common()),
        {name: int((classes == k).sum()) for k, name in enumerate(CLASSES)},
        {name: spread(sides[classes == k]) for k, name in enumerate(CLASSES)},
        int((visible < 0.9).sum()),
        spread(distances),
        {c: conditions[c] for c in PAPER_CONDITIONS} | {NONE_NOTED: sum(not s for s in shown)},
        dict(Counter(c for s in samples for c in s.conditions).most_common()),
        dict(Counter(s.split or SPLIT_UNKNOWN for s in samples).most_common()),
    )


def box_sides_px(samples: Sequence[Sample]) -> NDArray[np.float32]:
    """The longer side of every box (M,)."""
    boxes = np.concatenate([s.boxes for s in samples] or [np.zeros((0, 4), np.float32)])
    sides: NDArray[np.float32] = (boxes[:, 2:] - boxes[:, :2]).max(1, initial=0)
    return sides


def spread(values: ArrayLike) -> Spread | None:
    """How values spread; None where there are none."""
    array = np.asarray(values, np.float64)
    if not array.size:
        return None
    least, p10, median, p90, most = (
        round(float(v), 3) for v in np.percentile(array, [0, 10, 50, 90, 100])
    )
    return Spread(array.size, least, p10, median, p90, most)
