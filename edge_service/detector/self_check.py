"""Before a worker is ready: its detector finds drawn targets, and how long it takes for that."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edge_service.detector.drawn import draw
from edge_service.detector.nms import pairwise_iou
from edge_service.errors import SelfCheckError
from target_pose.candidate import Box, Detections
from target_pose.nesting import group
from target_pose.target import Target

RUNS = 15
LIMIT_S = 2.0
"""On a slow machine fewer runs must do."""
MIN_OVERLAP = 0.6
"""Intersection over union of a found box with the drawn one."""


class Detects(Protocol):
    """The part of a detector that is checked."""

    def detect(self, color_rgb: NDArray[np.uint8]) -> Detections:
        """All boxes of a picture (H, W, 3)."""
        ...


@dataclass(frozen=True, slots=True)
class SelfCheck:
    """What came of it."""

    found: int
    """Drawn targets that were found where they are."""
    drawn: int
    p50_ms: float
    """Time of one picture of 640x480, from pixels to boxes."""
    worst_ms: float

    @property
    def passed(self) -> bool:
        """Most were found: a far one may be too far for a small model."""
        return 2 * self.found > self.drawn


def self_check(detector: Detects, target: Target) -> SelfCheck:
    """Show drawn targets to a detector and time it."""
    pictures = draw(target)
    found = 0
    for picture in pictures:
        candidates = group(detector.detect(picture.color_rgb), target, picture.color_rgb)
        found += any(
            all(
                _overlap(box, picture.boxes[level]) >= MIN_OVERLAP for level, box in c.boxes.items()
            )
            for c in candidates
        )
    spent_ms: list[float] = []
    limit = time.perf_counter() + LIMIT_S
    while len(spent_ms) < RUNS and (not spent_ms or time.perf_counter() < limit):
        start = time.perf_counter()
        detector.detect(pictures[0].color_rgb)
        spent_ms.append(1000 * (time.perf_counter() - start))
    p50_ms = round(statistics.median(spent_ms), 2)
    return SelfCheck(found, len(pictures), p50_ms, round(max(spent_ms), 2))


def require(check: SelfCheck, what: str, target: Target) -> None:
    """Refuse a detector that did not pass.

    Raises:
        SelfCheckError: says what was found, and what to do.
    """
    if not check.passed:
        raise SelfCheckError(
            f"self-check: {what} found {check.found} of {check.drawn} drawn targets of kind "
            f"{target.name}; are these weights made for it? --self-check warn serves all the same"
        )


def _overlap(a: Box, b: Box) -> float:
    rows = [np.array([[box.x0, box.y0, box.x1, box.y1]], np.float32) for box in (a, b)]
    return float(pairwise_iou(*rows)[0, 0])
