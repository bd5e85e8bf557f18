"""What the detector hands to the localiser: boxes per level, and targets grouped from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from target_pose.points import PointPx
from target_pose.target import Level


@dataclass(frozen=True, slots=True)
class Box:
    """An axis-aligned box in the colour image; pixel (0, 0) is the centre of the first pixel."""

    x0: float
    y0: float
    x1: float
    y1: float
    score: float
    """Confidence in [0, 1]."""
    points: tuple[PointPx, ...] = ()
    """The target's labelled points as the net saw them with this box, in the target's order."""

    @property
    def center_px(self) -> tuple[float, float]:
        """Centre (u, v) [px]."""
        return (self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2

    @property
    def size_px(self) -> tuple[float, float]:
        """Width and height [px]."""
        return self.x1 - self.x0, self.y1 - self.y0


@dataclass(frozen=True, slots=True)
class Detections:
    """All boxes of one image after per-class non-maximum suppression, best first."""

    boxes: dict[Level, tuple[Box, ...]]


@dataclass(frozen=True, slots=True)
class Candidate:
    """One target: boxes of its levels that nest as the target's geometry says."""

    boxes: dict[Level, Box]
    """At least one level; a far or cut target may lack some."""
    score: float
    """What the net and the check of the rings say together, in [0, 1]."""
    points: Mapping[str, PointPx] = field(default_factory=lambda: MappingProxyType({}))
    """The target's labelled points by their names, as far as the net told any."""
