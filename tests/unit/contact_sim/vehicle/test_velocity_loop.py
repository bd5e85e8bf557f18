"""The cascade: which way it pushes, and that no limit of PX4's is exceeded."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_sim.vehicle.velocity_loop import (
    Craft,
    LoopSettings,
    LoopState,
    Sensed,
    Setpoint,
    step,
)
from rgbd_wire.quaternion import from_vector

CRAFT = Craft(3.3, 66.0, (7.6, 7.6, 1.0))
SETTINGS = LoopSettings()
DT_S = 0.004
ZERO = (0.0, 0.0, 0.0)
LEVEL = Sensed((1.0, 0.0, 0.0, 0.0), ZERO, ZERO, ZERO)
WEIGHT_N = 3.3 * 9.81

numbers = st.floats(-100.0, 100.0)
anything = st.tuples(numbers, numbers, numbers)
turns = st.tuples(*[st.floats(-1.5, 1.5)] * 3)


def run(wanted: Setpoint, sensed: Sensed, steps: int = 1):
    state = LoopState()
    for _ in range(steps):
        state, effort = step(state, wanted, sensed, DT_S, SETTINGS, CRAFT)
    return state, effort


def test_a_hover_takes_the_weight_and_no_torque():
    """At rest and told to rest, the thrust is the weight."""
    _, effort = run(Setpoint(), LEVEL)
    assert effort.thrust_n == pytest.approx(WEIGHT_N)
    assert effort.torque_body == pytest.approx(ZERO, abs=1e-12)


@pytest.mark.parametrize(
    ("velocity", "torque_sign"),
    [((1, 0, 0), (0, 1, 0)), ((-1, 0, 0), (0, -1, 0)), ((0, 1, 0), (-1, 0, 0))],
)
def test_it_leans_to_where_it_shall_go(velocity, torque_sign):
    """Forward by nose down, to the left by left side down (FLU)."""
    _, effort = run(Setpoint(velocity), LEVEL, 20)
    assert np.sign(np.round(effort.torque_body, 9)) == pytest.approx(torque_sign)


def test_the_world_s_velocity_is_flown_at_any_heading():
    """Turned to the north, a drone rolls right to fly east."""
    q = from_vector((0.0, 0.0, math.pi / 2))
    _, effort = run(Setpoint((1.0, 0.0, 0.0)), LEVEL._replace(q_world_from_body=q), 20)
    assert effort.torque_body[0] > 0.01
    assert effort.torque_body[1] == pytest.approx(0.0, abs=1e-9)


def test_a_climb_takes_more_thrust_and_a_turn_torque_about_z():
    """Up is more thrust; counter-clockwise is positive torque."""
    assert run(Setpoint((0.0, 0.0, 0.5)), LEVEL, 20)[1].thrust_n > WEIGHT_N + 1.0
    assert run(Setpoint(ZERO, 0.3), LEVEL)[1].torque_body[2] > 0.0


@given(anything, anything, anything, anything, turns, st.floats(-100.0, 100.0))
def test_no_limit_is_exceeded(wanted, velocity, acceleration, rates, turn, yaw_rate):
    """Whatever is wanted and sensed: acceleration, its change, thrust, torque stay in bounds."""
    s = SETTINGS
    sensed = Sensed(from_vector(turn), velocity, acceleration, rates)
    state = LoopState()
    for _ in range(30):
        before = state
        state, effort = step(state, Setpoint(wanted, yaw_rate), sensed, DT_S, s, CRAFT)
        x, y, z = state.acceleration_world
        assert math.hypot(x, y) <= s.mpc_acc_hor_max_mps2 + 1e-9
        assert -s.mpc_acc_down_max_mps2 <= z <= s.mpc_acc_up_max_mps2
        for a, b in zip(state.acceleration_world, before.acceleration_world, strict=True):
            assert abs(a - b) <= s.mpc_jerk_max_mps3 * DT_S + 1e-9
        assert s.mpc_thr_min * 66.0 <= effort.thrust_n <= s.mpc_thr_max * 66.0
        assert all(
            abs(t) <= most for t, most in zip(effort.torque_body, CRAFT.authority_nm, strict=True)
        )
        assert all(abs(i) <= s.mc_rr_int_lim for i in state.rate_integral)


@given(st.tuples(*[st.floats(-0.3, 0.3)] * 2, st.floats(-1.5, 1.5)))
def test_a_tilted_drone_is_turned_upright_the_short_way(turn):
    """Without a heading to hold, the torque is along SciPy's shortest turn of z to the sky."""
    q = from_vector(turn)
    sky_body = Rotation.from_rotvec(turn).inv().apply([0.0, 0.0, 1.0])
    _, effort = run(Setpoint(), LEVEL._replace(q_world_from_body=q))
    axis = np.cross([0.0, 0.0, 1.0], sky_body)
    torque = np.array(effort.torque_body)
    assert torque @ axis >= 0.0
    assert np.cross(torque, axis) == pytest.approx(np.zeros(3), abs=1e-9)
    # as hard as PX4's gains make it: attitude, then rate
    angle = 2.0 * np.sin(0.5 * np.arcsin(np.linalg.norm(axis)))
    expected = SETTINGS.mc_roll_p * SETTINGS.mc_rollrate_p * CRAFT.authority_nm[0] * angle
    assert np.linalg.norm(torque) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_while_it_still_leans_it_does_not_climb():
    """Tilted by 60 degrees and told to hover, the thrust is the weight's part along its own z."""
    q = from_vector((math.pi / 3, 0.0, 0.0))
    _, effort = run(Setpoint(), LEVEL._replace(q_world_from_body=q))
    assert effort.thrust_n == pytest.approx(0.5 * WEIGHT_N)


def test_an_error_that_stays_is_worked_against():
    """Held by something, it pushes harder with time: by PX4's integral gain."""
    early, _ = run(Setpoint((0.1, 0.0, 0.0)), LEVEL, 50)
    late, _ = run(Setpoint((0.1, 0.0, 0.0)), LEVEL, 300)
    grown = late.velocity_integral[0] - early.velocity_integral[0]
    assert grown == pytest.approx(SETTINGS.mpc_xy_vel_i_acc * 0.1 * 250 * DT_S)


def test_what_is_beyond_a_limit_is_not_learned():
    """An error of 10 m/s that the limit of the acceleration leaves standing winds nothing up."""
    state, _ = run(Setpoint((10.0, 0.0, 3.0)), LEVEL, 1000)
    assert abs(state.velocity_integral[0]) < 0.5 * SETTINGS.mpc_xy_vel_p_acc * 10.0
    assert state.velocity_integral[2] == 0.0


def test_bad_gains_are_refused():
    """The bounds are PX4's own, and named."""
    with pytest.raises(ValueError, match="mpc_tiltmax_air_rad"):
        LoopSettings(mpc_tiltmax_air_rad=2.0)
