"""Once a control tick: the robot's VIO and lidars to the autopilot's estimator.

ROS has no count of resets. A jump of the VIO is recognised here and counted into the sample, so
that the autopilot's estimator starts again there at once, and says so itself, instead of gliding to
the new place over a second (docs/odometry.md).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from drone_client.odometry import OdometrySample, RangeSample
from drone_client.odometry.jump import Jump, JumpSettings, JumpWatch, Motion
from drone_client.odometry.lidar import Lidar, LidarSettings
from drone_client.odometry.source import OdometrySource

SILENT_NS = 500_000_000
"""A VIO that has said nothing new for so long has fallen silent: some ten samples of a slow one."""
MAX_RESETS = 256
"""MAVLink counts in one byte."""


class Estimator(Protocol):
    """The part of an autopilot that is fed."""

    def give_odometry(self, sample: OdometrySample) -> None:
        """Take the robot's own odometry."""
        ...

    def give_range(self, sample: RangeSample) -> None:
        """Take a distance."""
        ...


class OdometryFeed:
    """Passes each sample on once. May be ticked from several threads."""

    def __init__(
        self,
        source: OdometrySource,
        estimator: Estimator,
        on_jump: Callable[[Jump], None] = lambda jump: None,
        jump: JumpSettings | None = None,
        lidar: LidarSettings | None = None,
    ) -> None:
        """Take over source and callbacks.

        Args:
            source: of the samples.
            estimator: gets them.
            on_jump: the VIO has jumped; for the ledger. Called before the sample that shows it is
                passed on. May ask for counts; must not tick.
            jump: what is a jump.
            lidar: when a distance is believed.
        """
        self.given = 0
        """Odometry samples that were passed on."""
        self.height = Lidar(lidar)
        self.ahead = Lidar(lidar)
        self._source = source
        self._estimator = estimator
        self._on_jump = on_jump
        self._watch = JumpWatch(jump)
        self._turn = threading.Lock()
        """One tick at a time, its callbacks included: samples stay in order."""
        self._lock = threading.Lock()
        """Of what is counted; never held while somebody is called."""
        self._passed_ns: int | None = None
        """Stamp of the newest sample that was passed on."""
        self._resets = 0
        self._odometry: OdometrySample | None = None
        self._ranges: dict[str, RangeSample] = {}

    def tick(self, now_ns: int) -> float | None:
        """Pass on what is new; returns the distance ahead that the mission may use, if any."""
        with self._turn:
            self._pass_odometry(self._source.odometry())
            self._pass_range("height", self._source.height(), self.height)
            self._pass_range("ahead", self._source.ahead(), self.ahead)
            return self.ahead.forward_m(now_ns)

    def silent(self, now_ns: int) -> bool:
        """Whether nothing of the VIO can be passed on any more; False before anything was.

        One that speaks on but has diverged is as good as silent.
        """
        with self._lock:
            passed_ns = self._passed_ns
        return passed_ns is not None and now_ns - passed_ns > SILENT_NS

    def counts(self) -> dict[str, int]:
        """What was given and what was not, for the summary."""
        with self._lock:
            return {
                "odometry_given": self.given,
                "odometry_jumps": self._watch.jumps.total(),
                "odometry_left_out": self._watch.left_out,
                **{f"height_{v.value}": n for v, n in self.height.verdicts.items()},
                **{f"ahead_{v.value}": n for v, n in self.ahead.verdicts.items()},
            }

    def _pass_odometry(self, sample: OdometrySample | None) -> None:
        if sample is None or sample is self._odometry:
            return
        self._odometry = sample
        motion = Motion.of(sample)
        with self._lock:
            jump = self._watch.see(motion)
            usable = self._watch.newest is motion  # else it came late, or is no number
            if usable:
                self.given += 1
                self._passed_ns = motion.t_ns
        if jump is not None:
            self._resets += 1
            self._on_jump(jump)
        if usable:
            resets = self._resets % MAX_RESETS
            same = sample.resets == resets
            self._estimator.give_odometry(sample if same else replace(sample, resets=resets))

    def _pass_range(self, name: str, sample: RangeSample | None, lidar: Lidar) -> None:
        if sample is None or sample is self._ranges.get(name):
            return
        self._ranges[name] = sample
        with self._lock:
            believed = lidar.see(sample)
        if believed is not None:
            self._estimator.give_range(believed)
