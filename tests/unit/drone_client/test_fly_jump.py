"""A jump of the odometry in a whole flight in real time, with all its threads."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drone_client.flight_settings import OdometrySettings
from drone_client.fly.cockpit import View
from drone_client.mission import Phase
from drone_client.odometry import OdometrySample, RangeSample
from drone_client.odometry.jump import JumpSettings
from drone_client.odometry.lidar import LidarSettings
from drone_client.odometry.source import MemoryOdometry
from drone_client.run_files import EVENTS_NAME, LEDGER_NAME, TICKS_NAME
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import FrameHeader, pose_of
from tests.unit.drone_client.builders import pose, target_of
from tests.unit.drone_client.test_fly import (
    CLOCK,
    WORLD_FROM_TARGET,
    AtTheWall,
    Scene,
)

AWAY = np.array([-0.2, 0.15, 0.17])
"""30 cm."""


class Astray(AtTheWall):
    """Its estimator jumps once when told to; the vehicle itself does not move."""

    def __init__(self) -> None:
        super().__init__()
        self.jumped_ns: int | None = None

    def jump(self) -> None:
        self.jumped_ns = self._clock.now_ns()

    def away_at(self, t_ns: int) -> np.ndarray:
        return np.zeros(3) if self.jumped_ns is None or t_ns < self.jumped_ns else AWAY

    def state(self):
        state = super().state()
        told = state.world_from_body
        away = self.away_at(state.t_pose_ns)
        return replace(state, world_from_body=Pose(told.translation + away, told.q_wxyz))


class AstrayScene(Scene):
    """A worker sees the true scene, whatever the drone believes of itself."""

    def _look(self, header: FrameHeader):
        if header.world_from_camera is None:
            return None
        told = pose_of(header.world_from_camera)
        away = self.vehicle.away_at(header.t_capture_ns)
        true = Pose(told.translation - away, told.q_wxyz)
        return target_of(true.inverse() @ WORLD_FROM_TARGET, np.diag([1e-7] * 6))


@pytest.mark.parametrize("phase", [Phase.ALIGN, Phase.APPROACH, Phase.CONTACT])
def test_a_jump_brakes_and_is_written_down(tmp_path, phase: Phase):
    """One event with its reason; nothing but standing until the target was measured again."""
    scene = AstrayScene(tmp_path, Astray())
    scene.when(phase, scene.vehicle.jump)
    scene.fly()
    events = scene.lines(EVENTS_NAME)
    jumped = [e for e in events if e["event"] == "odometry_jumped"]
    assert [e["reason"] for e in jumped] == ["position"]
    assert "jumped" in jumped[0]["sentence"]
    brake = next(e for e in events if e.get("after") == "brake")
    assert brake["reason"] == "odometry_jumped"
    left = next(e for e in events if e.get("before") == "brake")
    braking = [t for t in scene.lines(TICKS_NAME) if brake["t_ns"] <= t["t_ns"] < left["t_ns"]]
    assert braking[:-1]
    assert not any(np.any(t["command_mps"]) for t in braking[:-1] if t["phase"] == "brake")
    updates = [line.get("update") for line in scene.lines(LEDGER_NAME)]
    assert updates.count("first") == 2
    assert left["after"] == "retreat"


def end_soon_after(scene: Scene, jumped: Callable[[], bool]) -> None:
    """Interrupt the flight, and once more, when it has been looked at ten times after a jump."""
    look, views = scene.person.on_view, itertools.count()

    def on_view(view: View) -> None:
        look(view)
        if jumped() and next(views) >= 10:
            raise KeyboardInterrupt

    scene.person.on_view = on_view


def flown_beside_a_robot(scene: Scene, *, to_the_end: bool) -> dict[str, Any]:
    """The summary of a flight; the robot's VIO jumps by 40 cm while it lines up."""
    robot = MemoryOdometry()
    stop, jumps_now = threading.Event(), threading.Event()
    scene.when(Phase.ALIGN, jumps_now.set)
    if not to_the_end:
        end_soon_after(scene, jumps_now.is_set)

    def run_robot() -> None:
        while not stop.wait(0.01):
            now_ns = CLOCK.now_ns()
            where = pose((0.4, 0, 0)) if jumps_now.is_set() else pose()
            robot.newest_odometry = OdometrySample(now_ns, where, np.zeros(3))
            robot.newest_height = RangeSample(now_ns, 1.4)
            robot.newest_ahead = RangeSample(now_ns, 9.0, looks_down=False)

    thread = threading.Thread(target=run_robot, daemon=True)
    thread.start()
    try:
        return scene.fly(robot)
    finally:
        stop.set()
        thread.join()


def test_vio_and_lidars_go_to_the_autopilot_while_it_flies(tmp_path):
    """Given on from the control side; a jump of the VIO is counted into it, brakes, and is told."""
    scene = Scene(tmp_path)
    summary = flown_beside_a_robot(scene, to_the_end=True)
    assert scene.vehicle.given_odometry.resets >= 1
    assert scene.vehicle.given_range is not None
    assert summary["odometry"]["odometry_given"] > 10
    events = scene.lines(EVENTS_NAME)
    assert "position" in [e["reason"] for e in events if e["event"] == "vio_jumped"]
    assert not [e for e in events if e["event"] == "odometry_jumped"]
    brake = next(e for e in events if e.get("after") == "brake")
    assert brake["reason"] == "odometry_jumped"


def test_what_is_a_jump_and_when_a_distance_is_believed_is_as_tuned(tmp_path):
    """A VIO that may be half a metre off has not jumped; a lidar of one sample is taken at once."""
    scene = Scene(tmp_path)
    bold = JumpSettings(position_m=0.5, slide_m=0.5)
    tuned = OdometrySettings(vio_jump=bold, lidar=LidarSettings(window=1))
    scene.parts = replace(scene.parts, odometry=tuned)
    summary = flown_beside_a_robot(scene, to_the_end=False)
    assert summary["odometry"]["odometry_jumps"] == 0
    assert scene.vehicle.given_odometry.world_from_body.translation[0] == 0.4
    assert "height_undecided" not in summary["odometry"]
    assert summary["odometry"]["odometry_given"] > 10
    assert not [e for e in scene.lines(EVENTS_NAME) if e["event"] == "vio_jumped"]


def test_the_jumps_of_the_pose_that_it_flies_by_are_as_tuned(tmp_path):
    """What was a jump is none any more: nothing brakes for it, the measurements correct it."""
    scene = AstrayScene(tmp_path, Astray())
    bold = JumpSettings(position_m=0.5, slide_m=0.5)
    scene.parts = replace(scene.parts, odometry=OdometrySettings(jump=bold))
    scene.when(Phase.ALIGN, scene.vehicle.jump)
    end_soon_after(scene, lambda: scene.vehicle.jumped_ns is not None)
    scene.fly()
    assert scene.vehicle.jumped_ns is not None
    assert not [e for e in scene.lines(EVENTS_NAME) if e["event"] == "odometry_jumped"]
