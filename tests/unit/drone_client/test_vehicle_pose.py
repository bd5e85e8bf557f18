"""The vehicle's pose at the moment that is asked for, and the watch over it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drone_client.autopilot import VehicleState
from drone_client.fly.vehicle_pose import JUMPED_NS, MAX_AHEAD_NS, VehiclePose
from drone_client.odometry.jump import JumpReason
from tests.unit.drone_client.builders import MS, SECOND, pose

STATE = VehicleState(
    0,
    "OFFBOARD",
    armed=True,
    obeying=True,
    t_pose_ns=SECOND,
    world_from_body=pose((1, 2, 3)),
    velocity_world=np.zeros(3),
)


class Rig:
    """A vehicle that says what a test wants, and what became of it, in order."""

    def __init__(self) -> None:
        self.state: VehicleState | None = STATE
        self.log: list[tuple[str, object]] = []
        self.pose = VehiclePose(
            lambda: self.state,
            lambda t_ns, p: self.log.append(("keep", t_ns)),
            lambda jump: self.log.append(("jump", jump.reason)),
        )

    def later(self, ms: int, **changes: object) -> int:
        """The vehicle's next pose; returns its time."""
        assert self.state is not None
        t_ns = self.state.t_pose_ns + ms * MS
        self.state = replace(self.state, t_pose_ns=t_ns, **changes)
        return t_ns


def test_a_jump_is_told_before_its_pose_is_kept_or_given():
    """Whoever sees the new world's pose finds the old world's knowledge gone."""
    rig = Rig()
    rig.pose(SECOND)
    t_ns = rig.later(20, world_from_body=pose((1.3, 2, 3)))
    assert not rig.pose.jumped(t_ns)
    assert rig.pose(t_ns).translation[0] == 1.3
    assert rig.log == [("keep", SECOND), ("jump", JumpReason.POSITION), ("keep", t_ns)]
    assert rig.pose.jumped(t_ns)
    assert rig.pose.jumped(t_ns + JUMPED_NS - 1)
    assert not rig.pose.jumped(t_ns + JUMPED_NS)


def test_each_pose_is_looked_at_once():
    """Asked a hundred times between two of them, nothing is kept or judged twice."""
    rig = Rig()
    for i in range(100):
        rig.pose(SECOND + i * MS)
    assert rig.log == [("keep", SECOND)]


def test_a_reset_that_the_vehicle_counts_is_a_jump_even_at_the_same_time():
    """The count alone tells."""
    rig = Rig()
    rig.pose(SECOND)
    rig.later(0, pose_resets=1)
    rig.pose(SECOND)
    assert ("jump", JumpReason.RESET) in rig.log


def test_a_pose_that_comes_late_is_not_flown_by():
    """The newer one stands, and nothing is kept."""
    rig = Rig()
    rig.pose(SECOND)
    rig.later(-50, world_from_body=pose((9, 9, 9)))
    assert rig.pose(SECOND).translation[0] == 1.0
    assert rig.log == [("keep", SECOND)]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_vehicle_that_talks_nonsense_knows_nothing(bad):
    """No pose until it makes sense again, and then it is another world."""
    rig = Rig()
    rig.pose(SECOND)
    t_ns = rig.later(20, velocity_world=np.array([bad, 0, 0]))
    assert rig.pose(t_ns) is None
    t_ns = rig.later(20, velocity_world=np.zeros(3))
    assert rig.pose(t_ns) is not None
    assert rig.log == [("keep", SECOND), ("jump", JumpReason.NOT_A_NUMBER), ("keep", t_ns)]


def test_a_silence_is_no_pose_and_then_another_world():
    """After 150 ms nobody knows; after 300 ms nobody knows whether it jumped."""
    rig = Rig()
    rig.pose(SECOND)
    assert rig.pose(SECOND + MAX_AHEAD_NS) is not None
    assert rig.pose(SECOND + MAX_AHEAD_NS + 1) is None
    t_ns = rig.later(301)
    assert rig.pose(t_ns) is not None
    assert ("jump", JumpReason.GAP) in rig.log


def test_what_was_never_said_is_not_known():
    """No vehicle, no pose of it, no time of the pose."""
    rig = Rig()
    for state in (None, replace(STATE, world_from_body=None), replace(STATE, t_pose_ns=None)):
        rig.state = state
        assert rig.pose(SECOND) is None
    assert rig.log == []
