"""The one-dimensional lidar: down for the height, forward for the wall (docs/odometry.md).

Raw distances in, believed ones out: what the sensor cannot measure is nothing, a single echo of a
cable or of dust is outvoted by its neighbours, and a slanted beam is turned upright. What goes to
the autopilot as DISTANCE_SENSOR stays along the beam: its estimator knows the attitude itself.

Pure: time is an argument. No sample makes it raise.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass
from enum import StrEnum
from statistics import median_low

from drone_client.bounds import check_bounds
from drone_client.odometry import RangeSample
from rgbd_wire.geometry import Pose

_BOUNDS: dict[str, tuple[float, float]] = {
    "window": (1, 15),
    "window_ns": (10_000_000, 2_000_000_000),
    "stale_ns": (10_000_000, 2_000_000_000),
    "outlier_m": (0.01, 2.0),
    "outlier_share": (0.0, 0.5),
    "tilt_max_rad": (0.05, 1.0),
}


@dataclass(frozen=True, slots=True)
class LidarSettings:
    """When a distance is believed.

    Raises:
        ValueError: a value is out of its bounds, or no number.
    """

    window: int = 5
    """The median of so many samples is what the others are held against."""
    window_ns: int = 300_000_000
    """Older ones have no vote."""
    stale_ns: int = 200_000_000
    """A distance that is older says nothing about now."""
    outlier_m: float = 0.15
    """Further from the median than this and the share of it, and a sample is an outlier: half a
    metre a second over the window, and noise."""
    outlier_share: float = 0.05
    tilt_max_rad: float = 0.35
    """A beam that is slanted by more looks at something else."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)
        if self.window % 2 == 0:
            raise ValueError(f"LidarSettings.window = {self.window} is not odd: a median needs it")


class RangeVerdict(StrEnum):
    """What became of a sample."""

    TAKEN = "taken"
    OUT_OF_RANGE = "out_of_range"
    """The sensor sees nothing, or too near, or says no number."""
    OUTLIER = "outlier"
    """Its neighbours say otherwise."""
    UNDECIDED = "undecided"
    """Too few neighbours to say."""
    LATE = "late"
    """Not newer than the one before."""


class Lidar:
    """One beam: takes every sample, and says what may be believed. Not thread-safe."""

    def __init__(self, settings: LidarSettings | None = None) -> None:
        self.verdicts: Counter[RangeVerdict] = Counter()
        self._settings = settings or LidarSettings()
        self._recent: deque[RangeSample] = deque(maxlen=self._settings.window)
        self._t_ns: int | None = None
        self._taken: RangeSample | None = None

    def see(self, sample: RangeSample) -> RangeSample | None:
        """Take the next sample; itself, if it may be passed on to the autopilot, or None.

        That the sensor sees nothing is told to the autopilot as well.
        """
        verdict = self._judge(sample)
        self.verdicts[verdict] += 1
        if verdict is RangeVerdict.TAKEN:
            self._taken = sample
        elif verdict is RangeVerdict.OUT_OF_RANGE:
            self._taken = None
        else:
            return None
        return sample

    def newest(self, now_ns: int) -> RangeSample | None:
        """The newest that is believed, along the beam; None: there is none, or it is stale."""
        taken = self._taken
        if taken is None or not 0 <= now_ns - taken.t_ns <= self._settings.stale_ns:
            return None
        return taken

    def forward_m(self, now_ns: int) -> float | None:
        """What the mission may use as ``Senses.forward_m``; None: nothing, or the beam looks down.

        Along the beam: the mission holds it against the tip, along the same axis of the body.
        """
        newest = self.newest(now_ns)
        return None if newest is None or newest.looks_down else newest.distance_m

    def upright_m(self, now_ns: int, world_from_body: Pose | None) -> float | None:
        """Distance with the body's tilt taken out; None: not believed, stale, or too slanted.

        Down: the height over level ground. Forward: the way along the horizontal to an upright
        wall that the robot faces.
        """
        sample = self.newest(now_ns)
        if sample is None or world_from_body is None:
            return None
        cosine = upright(world_from_body, looks_down=sample.looks_down)
        if not cosine >= math.cos(self._settings.tilt_max_rad):
            return None
        return sample.distance_m * cosine

    def _judge(self, sample: RangeSample) -> RangeVerdict:
        if self._t_ns is not None and sample.t_ns <= self._t_ns:
            if self._t_ns - sample.t_ns < self._settings.window_ns:
                return RangeVerdict.LATE
            self._recent.clear()  # its clock went back: it has begun again
            self._taken = None
        self._t_ns = sample.t_ns
        if not is_measured(sample):
            return RangeVerdict.OUT_OF_RANGE
        self._recent.append(sample)
        voters = [
            s.distance_m for s in self._recent if sample.t_ns - s.t_ns <= self._settings.window_ns
        ]
        if len(voters) <= self._settings.window // 2:
            return RangeVerdict.UNDECIDED
        middle_m = median_low(voters)
        allowed_m = self._settings.outlier_m + self._settings.outlier_share * middle_m
        near = abs(sample.distance_m - middle_m) <= allowed_m
        return RangeVerdict.TAKEN if near else RangeVerdict.OUTLIER


def is_measured(sample: RangeSample) -> bool:
    """Whether the sensor can measure that distance, and says what it can measure."""
    return sample.valid and 0.0 <= sample.min_m < sample.max_m < math.inf


def upright(world_from_body: Pose, *, looks_down: bool) -> float:
    """Cosine of the beam's slant.

    Down: between the body's down and the world's. Forward: between the body's x and the
    horizontal.
    """
    rotation = world_from_body.rotation
    return float(rotation[2, 2]) if looks_down else math.hypot(rotation[0, 0], rotation[1, 0])
