"""PX4's motors: which one is where, what it lifts, and which way the drone turns by it."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.errors import VehicleError
from contact_sim.hil.motors import Controls, Motors
from contact_sim.scene.drone import MASS_KG, rotor_places
from contact_sim.simulation import SimulationSettings
from contact_sim.vehicle.rotors import MAX_THRUST_N
from tests.unit.contact_sim.flights import AIRFRAME, simulation

PLACES = rotor_places(AIRFRAME)
FRONT_RIGHT, REAR_LEFT, FRONT_LEFT, REAR_RIGHT = range(4)
HOVER = MASS_KG * 9.81 / (4 * MAX_THRUST_N)


def controls(*motors: float, armed: bool = True) -> Controls:
    return Controls(0, motors, armed, lockstep=True)


def thrusts(motors: Motors, *controlled: float, armed: bool = True) -> tuple:
    return motors.thrusts(controls(*controlled, armed=armed), Counter())


@pytest.mark.parametrize(
    ("motor", "ahead", "left"),
    [
        (FRONT_RIGHT, True, False),
        (REAR_LEFT, False, True),
        (FRONT_LEFT, True, True),
        (REAR_RIGHT, False, False),
    ],
)
@pytest.mark.parametrize("order", list(itertools.permutations(range(4)))[::5])
def test_each_motor_turns_the_rotor_that_px4_means(motor, ahead, left, order):
    """Motor by motor, in whatever order an airframe lists its rotors."""
    places = [PLACES[i] for i in order]
    lone = [0.0] * 4
    lone[motor] = 1.0
    lifted = thrusts(Motors.of(places), *lone)
    (turning,) = [place for place, n in zip(places, lifted, strict=True) if n > 0.0]
    assert (turning[0] > 0.0, turning[1] > 0.0) == (ahead, left)


@pytest.mark.parametrize(
    ("stronger", "axis", "sign"),
    [
        ((REAR_LEFT, FRONT_LEFT), 0, 1),  # rolls right: FLU x
        ((FRONT_RIGHT, FRONT_LEFT), 1, -1),  # nose up: about -y of FLU
        ((FRONT_RIGHT, REAR_LEFT), 2, -1),  # both counter-clockwise: the body turns clockwise
    ],
)
def test_the_drone_turns_as_px4_expects(stronger, axis, sign):
    """A tenth of a second of unequal motors in the simulation itself, in the air."""
    sim = simulation(settings=SimulationSettings(rotors_from_outside=True))
    motors = Motors.of(PLACES)
    sim.set_rotors(thrusts(motors, *[HOVER + (0.1 if i in stronger else -0.1) for i in range(4)]))
    sim.step(50)
    rates = sim.truth.rates_body
    assert np.argmax(np.abs(rates)) == axis
    assert rates[axis] * sign > 0.05


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_curve_is_px4_s(control, curve):
    """``f u^2 + (1 - f) u``: from nothing to all, and linear at 0."""
    lifted = thrusts(Motors.of(PLACES, curve), *[control] * 4)
    expected = MAX_THRUST_N * (curve * control**2 + (1 - curve) * control)
    assert lifted == pytest.approx([expected] * 4)
    assert max(lifted) <= MAX_THRUST_N


def test_it_hovers_where_px4_expects_it():
    """MPC_THR_HOVER is 0.5 by default; this drone's is 0.49."""
    assert abs(HOVER - 0.49) < 0.005


def test_what_is_no_number_stands_still_and_is_counted():
    """NaN and infinities, each motor for itself."""
    faults: Counter[str] = Counter()
    motors = Motors((0, 1, 2, 3))
    said = controls(math.nan, math.inf, -math.inf, 0.5)
    assert motors.thrusts(said, faults) == (0.0, 0.0, 0.0, 0.5 * MAX_THRUST_N)
    assert faults == {"not_a_number": 3}


@given(st.lists(st.floats(allow_nan=True, width=32), min_size=4, max_size=4), st.booleans())
def test_whatever_comes_is_a_thrust_of_a_rotor(said, armed):
    """Any four floats: within what the simulation takes, and nothing of them when disarmed."""
    faults: Counter[str] = Counter()
    lifted = Motors.of(PLACES, 0.3).thrusts(controls(*said, armed=armed), faults)
    assert all(0.0 <= n <= MAX_THRUST_N for n in lifted)
    bad = sum(not 0.0 <= u <= 1.0 for u in said)
    assert sum(faults.values()) == (bad if armed else 0)
    assert armed or lifted == (0.0, 0.0, 0.0, 0.0)


def test_a_drone_without_an_x_and_a_curve_out_of_range_are_refused():
    """With words."""
    with pytest.raises(VehicleError, match="four rotors are needed"):
        Motors.of(PLACES[:3])
    for curve in (-0.1, 1.1, math.nan):
        with pytest.raises(ValueError, match="a thrust curve is from 0 to 1"):
            Motors.of(PLACES, curve)
