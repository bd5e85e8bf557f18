"""Mixing: what the rotors are told adds up to what was wanted, and what gives way first."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.errors import VehicleError
from contact_sim.vehicle.rotors import DRAG_TORQUE_M, MAX_THRUST_N, Effort, Mixer

PLACES = ((0.23, 0.23, 0.05), (0.23, -0.23, 0.05), (-0.23, 0.23, 0.05), (-0.23, -0.23, 0.05))
MIXER = Mixer.of(PLACES)
HOVER_N = 32.4


def made(thrusts) -> np.ndarray:
    """Thrust and torque of rotors, from moments about the body's origin."""
    total = np.zeros(4)
    for place, spin, f in zip(PLACES, MIXER.spin, thrusts, strict=True):
        force = np.array([0.0, 0.0, f])
        moment = np.cross(place, force) + [0.0, 0.0, spin * DRAG_TORQUE_M * f]
        total += [f, *moment]
    return total


@given(*[st.floats(-1.0, 1.0)] * 4)
def test_what_fits_is_made_exactly(lift, roll, pitch, yaw):
    """Within reach, thrust and torque are those that were wanted."""
    effort = Effort(HOVER_N + 5.0 * lift, (roll, pitch, 0.2 * yaw))
    assert made(MIXER.thrusts(effort)) == pytest.approx(
        [effort.thrust_n, *effort.torque_body], abs=1e-9
    )


@given(*[st.floats(-100.0, 100.0)] * 4)
def test_no_rotor_leaves_its_range(lift, roll, pitch, yaw):
    """Whatever is wanted, a rotor neither pulls nor does more than it can."""
    thrusts = MIXER.thrusts(Effort(lift, (roll, pitch, yaw)))
    assert all(-1e-9 <= f <= MAX_THRUST_N + 1e-9 for f in thrusts)


@given(st.floats(-7.0, 7.0), st.floats(0.0, 66.0), st.floats(-3.0, 3.0))
def test_rolling_is_given_up_last(roll, lift, yaw):
    """Short of room, lift and turning give way, and the roll that keeps it upright is made."""
    thrusts = MIXER.thrusts(Effort(lift, (roll, 0.0, 0.0)))
    assert made(thrusts)[1] == pytest.approx(roll, abs=1e-9)
    turning = made(MIXER.thrusts(Effort(lift, (roll, 0.0, yaw))))
    assert abs(turning[3]) <= abs(yaw) + 1e-9
    assert turning[3] * yaw >= -1e-9


def test_authority_is_what_half_of_the_rotors_make():
    """A torque of the authority is made with two rotors full and two at rest."""
    roll, pitch, yaw = MIXER.authority_nm
    for axis, torque in ((1, (roll, 0.0, 0.0)), (2, (0.0, pitch, 0.0))):
        thrusts = MIXER.thrusts(Effort(2.0 * MAX_THRUST_N, torque))
        assert sorted(thrusts) == pytest.approx([0.0, 0.0, MAX_THRUST_N, MAX_THRUST_N])
        assert made(thrusts)[axis] == pytest.approx(sum(torque))
    assert made(MIXER.thrusts(Effort(2.0 * MAX_THRUST_N, (0.0, 0.0, yaw))))[3] == pytest.approx(yaw)


@pytest.mark.parametrize(
    "places",
    [PLACES[:3], (*PLACES[:3], (0.3, 0.3, 0.0)), tuple((0.0, y, z) for _, y, z in PLACES)],
    ids=["three", "two in one quarter", "in a row"],
)
def test_other_airframes_are_refused(places):
    """The mixer says which places it cannot fly with."""
    with pytest.raises(VehicleError, match="one in each quarter"):
        Mixer.of(places)
