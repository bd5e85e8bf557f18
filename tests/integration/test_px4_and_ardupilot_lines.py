"""The shell around a line in memory: ArduPilot's modes, a deaf line, and samples that are none."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot.ardupilot import ARDUPILOT
from drone_client.autopilot.flavour import Flavour
from drone_client.autopilot.line import Received
from drone_client.autopilot.mavlink import MavlinkAutopilot
from drone_client.autopilot.px4 import PX4
from drone_client.autopilot.settings import AutopilotSettings
from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.geometry import Pose
from tests.integration.px4_process import Commander, engaged, until


class MemoryLine:
    """A wire to a small vehicle that takes each mode it is asked for."""

    is_datagram = True

    def __init__(self, autopilot: int, mode: int) -> None:
        self.dropped = 0
        self.deaf = False
        self.mode = mode
        self.asked: list[tuple[int, int]] = []
        self.arrived: list[str] = []
        self.odometry: list[mav.MAVLink_message] = []
        self._autopilot = autopilot
        self._closed = threading.Event()
        self._parser = mav.MAVLink(None)
        self._sender = mav.MAVLink(None, 1, 1)

    def read(self, timeout_s: float) -> Received | None:
        """A heartbeat each time that the timeout is over."""
        self._closed.wait(timeout_s)
        message = mav.MAVLink_heartbeat_message(2, self._autopilot, 129, self.mode, 4, 3)
        return Received(message.pack(self._sender), None)

    def write(self, message: bytes) -> bool:
        if self.deaf:
            self.dropped += 1
            return False
        for m in self._parser.parse_buffer(message) or []:
            self.arrived.append(m.get_type())
            if m.get_type() == "ODOMETRY":
                self.odometry.append(m)
            if m.get_type() == "COMMAND_LONG" and m.command == mav.MAV_CMD_DO_SET_MODE:
                self.asked.append((int(m.param2), int(m.param3)))
                self.mode = int(m.param2)
        return True

    def answer_to(self, source: object) -> None:
        pass

    def close(self) -> None:
        self._closed.set()


def opened(flavour: Flavour, line: MemoryLine) -> MavlinkAutopilot:
    return MavlinkAutopilot(line, flavour, MonotonicClock(), AutopilotSettings(rate_hz=100.0))


def test_ardupilot_is_taken_in_guided_and_left_in_brake() -> None:
    """The same order with other numbers."""
    line = MemoryLine(mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 5)
    autopilot = opened(ARDUPILOT, line)
    try:
        until(lambda: autopilot.state(), "a heartbeat")
        assert autopilot.state().mode == "LOITER"
        autopilot.engage()
        Commander(autopilot).fly((0.0, 0.0, 0.1), lambda: engaged(autopilot))
        assert line.asked == [(4, 0)]
        assert autopilot.state().mode == "GUIDED"
        autopilot.release()
        until(lambda: autopilot.phase == "silent", "released")
        assert line.asked == [(4, 0), (17, 0)]
        assert line.arrived.index("SET_POSITION_TARGET_LOCAL_NED") < line.arrived.index(
            "COMMAND_LONG", line.arrived.index("SET_POSITION_TARGET_LOCAL_NED")
        )
    finally:
        autopilot.close()


def test_a_line_that_takes_nothing_ends_the_engagement() -> None:
    """What the line drops is silence: PX4 acts by itself, and we do not come back."""
    line = MemoryLine(mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 5)
    autopilot = opened(ARDUPILOT, line)
    try:
        until(lambda: autopilot.state(), "a heartbeat")
        autopilot.engage()
        commander = Commander(autopilot)
        commander.fly((0.0, 0.0, 0.1), lambda: engaged(autopilot))
        line.deaf = True
        commander.fly((0.0, 0.0, 0.1), lambda: autopilot.phase == "silent")
        assert autopilot.reason == "no setpoint left for too long"
        assert autopilot.counts()["not_sent"] > 0
    finally:
        autopilot.close()


@pytest.mark.parametrize(
    "sample",
    [
        OdometrySample(1, Pose.identity(), np.array([np.nan, 0.0, 0.0])),
        OdometrySample(1, Pose.identity(), np.zeros(2)),
        OdometrySample(1, Pose(np.array([1e9, 0.0, 0.0]), np.eye(4)[0]), np.zeros(3)),
        OdometrySample(1, Pose.identity(), None),  # type: ignore[arg-type]
        None,
    ],
)
def test_odometry_that_is_none_is_counted_and_never_raises(sample: OdometrySample) -> None:
    """Not finite, of the wrong shape, far away, or no sample at all."""
    line = MemoryLine(mav.MAV_AUTOPILOT_PX4, 3 << 16)
    autopilot = opened(PX4, line)
    try:
        autopilot.give_odometry(sample)
        autopilot.give_range(RangeSample(1, float("nan")))
        assert autopilot.refused == {"odometry_sample": 1, "range_sample": 1}
        assert "ODOMETRY" not in line.arrived
    finally:
        autopilot.close()


def test_odometry_without_a_covariance_says_so() -> None:
    """The first number is NaN and the quality unknown; nothing is made up."""
    line = MemoryLine(mav.MAV_AUTOPILOT_PX4, 3 << 16)
    autopilot = opened(PX4, line)
    try:
        autopilot.give_odometry(OdometrySample(5_000_000, Pose.identity(), np.zeros(3)))
        (message,) = line.odometry
        assert np.isnan(message.pose_covariance[0])
        assert message.quality == 0
        assert message.time_usec == 5000
    finally:
        autopilot.close()
