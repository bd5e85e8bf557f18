"""Playing a recording as if it happened now: at real speed, or each frame after the last's answer.

The recording's own time line is mapped on the drone's clock here and nowhere else. From here on
everything is as in flight: frames are stamped by the drone's clock, poses come at control rate.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Protocol

from drone_client.airframe import Airframe
from drone_client.source import Capture, RgbdSource
from rgbd_wire.clock import Clock
from rgbd_wire.geometry import Pose


class Playback(Protocol):
    """Gives each capture when it is due, and the drone's pose at any time."""

    def captures(self) -> Iterator[tuple[int, Capture]]:
        """Time of exposure [ns, drone's clock] and capture, each when it is due."""
        ...

    def world_from_body(self, now_ns: int) -> Pose | None:
        """Odometry, now; None: unknown."""
        ...


class RealTime:
    """At the speed of the recording; a capture that cannot be loaded in time comes late."""

    def __init__(
        self, source: RgbdSource, airframe: Airframe, clock: Clock, stop: threading.Event
    ) -> None:
        self._source = source
        self._camera_from_body = airframe.body_from_camera.inverse()
        self._clock = clock
        self._stop = stop
        self._offset_ns: int | None = None
        """Drone's clock minus the recording's time line."""

    def captures(self) -> Iterator[tuple[int, Capture]]:
        """Each capture at its time."""
        for capture in self._source.captures():
            now_ns = self._clock.now_ns()
            if self._offset_ns is None:
                self._offset_ns = now_ns - capture.t_source_ns
            due_ns = capture.t_source_ns + self._offset_ns
            if self._stop.wait(max(0, due_ns - now_ns) / 1e9):
                return
            yield due_ns, capture

    def world_from_body(self, now_ns: int) -> Pose | None:
        """Interpolated ground truth of the recording."""
        if self._offset_ns is None:
            return None
        world_from_camera = self._source.world_from_camera(now_ns - self._offset_ns)
        return None if world_from_camera is None else world_from_camera @ self._camera_from_body


class Lockstep:
    """Each capture as soon as the one before it is settled; the drone waits where it is."""

    def __init__(
        self,
        source: RgbdSource,
        airframe: Airframe,
        clock: Clock,
        stop: threading.Event,
        settled: threading.Event,
    ) -> None:
        self._source = source
        self._camera_from_body = airframe.body_from_camera.inverse()
        self._clock = clock
        self._stop = stop
        self._settled = settled
        self._here: Pose | None = None

    def captures(self) -> Iterator[tuple[int, Capture]]:
        """Each capture after the fate of the last is known."""
        for capture in self._source.captures():
            world_from_camera = self._source.world_from_camera(capture.t_source_ns)
            # The drone jumps from one capture's place to the next. Until the flight has been told
            # of the new place, at the time of exposure, nobody asks for one in between.
            self._here = None
            self._settled.clear()
            yield self._clock.now_ns(), capture
            if world_from_camera is not None:
                self._here = world_from_camera @ self._camera_from_body
            while not self._settled.wait(0.05):
                if self._stop.is_set():
                    return

    def world_from_body(self, now_ns: int) -> Pose | None:
        """The pose of the capture that is under way."""
        return self._here
