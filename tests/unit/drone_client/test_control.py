"""One control tick: nothing known means stop; what is known is used at its age, in any frame."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.airframe import Airframe
from drone_client.cbf import FilterSettings, Freshness, Status
from drone_client.control import ControlSettings, Known, decide, stop_command
from drone_client.target import Source, TargetEstimate, drift_covariance
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import MS, SECOND, pose, poses

AIRFRAME = Airframe()
SETTINGS = ControlSettings()
NOW_NS = 100 * SECOND
COVARIANCE = np.diag([1e-6] * 3 + [1e-5] * 3)
BOARD = pose((5, 0, 1.5), (0, 0, np.pi))
"""A target that faces west: its x is the world's -x, its z up."""


def estimate(world_from_target: Pose, age_ns: int = 50 * MS, range_m: float = 2.0):
    return TargetEstimate(world_from_target, COVARIANCE, NOW_NS - age_ns, range_m)


def decided(world_from_target: Pose, world_from_body: Pose, age_ns: int = 50 * MS):
    return decide(NOW_NS, estimate(world_from_target, age_ns), world_from_body, AIRFRAME, SETTINGS)


def test_without_a_target_the_drone_stands_still():
    """Never seen: a zero command with the time of the tick."""
    d = decide(NOW_NS, None, pose(), AIRFRAME, SETTINGS)
    assert (d.known, d.safe, d.age_ns, d.tip_target) == (Known.NO_TARGET, None, None, None)
    np.testing.assert_array_equal(d.command.velocity_world, np.zeros(3))
    assert (d.command.yaw_rate_radps, d.command.t_ns) == (0.0, NOW_NS)


def test_without_its_own_pose_the_drone_stands_still():
    """A target in the world is of no use to a drone that does not know where it is."""
    d = decide(NOW_NS, estimate(BOARD), None, AIRFRAME, SETTINGS)
    assert (d.known, d.safe, d.age_ns) == (Known.NO_POSE, None, 50 * MS)
    np.testing.assert_array_equal(d.command.velocity_world, np.zeros(3))
    assert d.command.yaw_rate_radps == 0.0


def test_a_stop_command_is_zero():
    """And carries its time."""
    command = stop_command(7)
    assert not command.velocity_world.any()
    assert (command.yaw_rate_radps, command.t_ns) == (0.0, 7)


def test_in_front_of_the_board_the_drone_closes_in():
    """Square to it and on its axis: straight ahead, no yaw, the tip where the airframe says."""
    d = decided(BOARD, pose((3, 0, 1.5)))
    assert d.known is Known.TARGET
    tip_x = 5 - 3 - AIRFRAME.body_from_tip.translation[0]
    np.testing.assert_allclose(d.tip_target, (tip_x, 0, 0), atol=1e-9)
    assert d.command.velocity_world[0] > 0.05
    np.testing.assert_allclose(d.command.velocity_world[1:], 0, atol=1e-9)
    assert abs(d.command.yaw_rate_radps) < 1e-9
    assert d.safe.status in (Status.INACTIVE, Status.ACTIVE)


@pytest.mark.parametrize(
    ("offset", "axis", "sign"),
    [((0, 0.05, 0), 1, -1), ((0, -0.05, 0), 1, 1), ((0, 0, 0.05), 2, -1)],
)
def test_beside_the_axis_the_drone_moves_towards_it(offset, axis, sign):
    """Left of it to the right, above it down: no axis of any frame is turned round."""
    start = np.array([2.5, 0, 1.5]) + offset
    v = decided(BOARD, pose(start)).command.velocity_world
    assert sign * v[axis] > 0.01


@pytest.mark.parametrize(("turn", "sign"), [(0.3, -1), (-0.3, 1)])
def test_turned_away_the_drone_yaws_back(turn, sign):
    """Counter-clockwise is positive, seen from above."""
    d = decided(BOARD, pose((2.5, 0, 1.5), (0, 0, turn)))
    assert sign * d.command.yaw_rate_radps > 0.01


@pytest.mark.parametrize("tilt", [0.0, 0.5])
@pytest.mark.parametrize("turn", [0.3, -0.2])
def test_a_drone_that_only_turns_keeps_its_tip_where_it_is(tilt, turn):
    """The body moves against the swing of the arm: minus yaw rate times up cross lever arm."""
    board = BOARD @ pose((0, 0, 0), (0, tilt, 0))
    tip_world = board @ np.array([1.5, 0, 0])  # on the axis, with nothing to correct sideways
    attitude = pose((0, 0, 0), (0, 0, turn))
    lever_world = attitude.rotation @ AIRFRAME.body_from_tip.translation
    body = pose(tip_world - lever_world, (0, 0, turn))
    d = decided(board, body, age_ns=SETTINGS.filter.age_max_ns + 1)  # HOLD: no approach
    yaw_rate = d.command.yaw_rate_radps
    assert abs(yaw_rate) > 0.05
    swing = yaw_rate * np.cross((0, 0, 1), lever_world)
    np.testing.assert_allclose(d.command.velocity_world, -swing, atol=1e-9)


@given(poses, poses, st.integers(0, 10 * SECOND), st.floats(0, 50), st.floats(-6, 2))
def test_no_command_exceeds_the_limits(board, body, age_ns, range_m, magnitude):
    """Any poses, any age, any uncertainty: speed and yaw rate within the settings."""
    known = TargetEstimate(board, 10**magnitude * np.eye(6), NOW_NS - age_ns, range_m)
    command = decide(NOW_NS, known, body, AIRFRAME, SETTINGS).command
    assert np.linalg.norm(command.velocity_world) <= SETTINGS.filter.v_max_mps + 1e-9
    assert abs(command.yaw_rate_radps) <= SETTINGS.filter.yaw_rate_max_radps + 1e-9


def test_a_smaller_limit_is_kept_too():
    """The limit is the settings', not a constant."""
    slow = ControlSettings(filter=FilterSettings(v_max_mps=0.1))
    d = decide(NOW_NS, estimate(BOARD), pose((2, 0.4, 1.5)), AIRFRAME, slow)
    assert 0.02 < np.linalg.norm(d.command.velocity_world) <= 0.1 + 1e-12


@given(st.integers(0, 2**32 - 1))
def test_the_choice_of_the_world_frame_changes_nothing_but_the_axes(seed):
    """Turn the world about z and move it: the command turns with it, everything else is equal."""
    rng = np.random.default_rng(seed)
    tilted = pose((0, 0, 0), rng.normal(size=3) * 0.3)
    board = pose(rng.uniform(-3, 3, 3), (0, 0, rng.uniform(-3, 3))) @ tilted
    in_front = np.array([rng.uniform(0.6, 3), *rng.uniform(-0.6, 0.6, 2)])
    facing = board @ pose(in_front, (0, 0, np.pi))
    body = facing @ pose((0, 0, 0), rng.normal(size=3) * 0.15)
    age_ns = int(rng.choice([20, 250, 450, 900, 3000])) * MS
    angle = rng.uniform(-3, 3)
    other = pose(rng.uniform(-50, 50, 3), (0, 0, angle))

    here, there = decided(board, body, age_ns), decided(other @ board, other @ body, age_ns)
    turned = other.rotation @ here.command.velocity_world
    np.testing.assert_allclose(there.command.velocity_world, turned, atol=1e-7)
    assert there.command.yaw_rate_radps == pytest.approx(here.command.yaw_rate_radps, abs=1e-7)
    np.testing.assert_allclose(there.tip_target, here.tip_target, atol=1e-9)
    assert (there.safe.status, there.safe.freshness) == (here.safe.status, here.safe.freshness)
    assert there.safe.h == pytest.approx(here.safe.h, abs=1e-7)


def test_the_age_is_looked_at_on_every_tick():
    """The same knowledge, older and older: close in, hold the distance, stop, back off."""
    f = SETTINGS.filter
    body = pose((3.6, 0, 1.5))
    away = BOARD.rotation[:, 0]  # out of the board
    expected = [
        (f.age_max_ns, Freshness.FRESH),
        (f.age_max_ns + 1, Freshness.HOLD),
        (f.hold_ns, Freshness.HOLD),
        (f.hold_ns + 1, Freshness.BRAKE),
        (f.retreat_ns, Freshness.BRAKE),
        (f.retreat_ns + 1, Freshness.RETREAT),
    ]
    for age_ns, phase in expected:
        d = decided(BOARD, body, age_ns)
        assert d.age_ns == age_ns
        assert d.safe.freshness is phase
        speed_away = float(away @ d.command.velocity_world)
        if phase is Freshness.FRESH:
            assert speed_away < -0.01
        elif phase is Freshness.RETREAT:
            assert speed_away > 0.01
        else:
            assert speed_away >= -1e-12
            assert d.safe.status is Status.STALE


def test_what_is_certain_shrinks_with_age():
    """Past age_max the error ball grows: h at the estimate stays, the h that is certain falls."""
    body = pose((3.4, 0.02, 1.5))
    old_ns = SETTINGS.filter.age_max_ns
    safe = [decided(BOARD, body, old_ns + age * 100 * MS).safe for age in range(12)]
    assert len({round(s.h, 12) for s in safe}) == 1
    assert all(a.h_robust > b.h_robust for a, b in pairwise(safe))


def test_a_worse_measurement_makes_for_more_margin():
    """Sigma and range go into the error ball."""
    body = pose((3.4, 0.02, 1.5))

    def delta(covariance, range_m: float) -> float:
        known = TargetEstimate(BOARD, covariance, NOW_NS, range_m)
        return decide(NOW_NS, known, body, AIRFRAME, SETTINGS).safe.delta_m

    assert delta(COVARIANCE, 1.0) < delta(100 * COVARIANCE, 1.0)
    assert delta(COVARIANCE, 1.0) < delta(COVARIANCE, 4.0)


def test_an_age_that_cannot_be_stops_the_approach():
    """A capture from the future is a broken clock."""
    d = decided(BOARD, pose((3, 0, 1.5)), age_ns=-1)
    assert d.safe.freshness is Freshness.BRAKE
    assert float(BOARD.rotation[:, 0] @ d.command.velocity_world) >= -1e-12


def test_own_eyes_widen_the_margin_by_the_time_since_the_edge_spoke():
    """The source is told; the drift that stands in its covariance is not counted a second time."""
    body = pose((3.4, 0.02, 1.5))
    edge = estimate(BOARD)
    alone_ns = 2 * SECOND
    widened = COVARIANCE + drift_covariance(alone_ns - 50 * MS)
    own = replace(edge, covariance=widened, source=Source.ONBOARD, t_confirmed_ns=NOW_NS - alone_ns)
    by_edge = decide(NOW_NS, edge, body, AIRFRAME, SETTINGS)
    by_own = decide(NOW_NS, own, body, AIRFRAME, SETTINGS)
    assert (by_edge.source, by_edge.unconfirmed_ns) == (Source.EDGE, 0)
    assert (by_own.source, by_own.unconfirmed_ns) == (Source.ONBOARD, alone_ns)
    grown = by_own.safe.delta_m - by_edge.safe.delta_m
    f = SETTINGS.filter
    assert grown == pytest.approx(f.unconfirmed_mps * (alone_ns - f.age_max_ns) / 1e9, abs=1e-6)
    assert by_own.safe.freshness is Freshness.FRESH
