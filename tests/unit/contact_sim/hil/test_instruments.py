"""What PX4's sensors would say, with SciPy's rotations as the judge of every sign."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_sim.hil.instruments import (
    FIELD_NOISE_GAUSS,
    PRESSURE_NOISE_HPA,
    SLOW_NS,
    Instruments,
    Reading,
)
from contact_sim.hil.place import Place, air_at
from contact_sim.sensing.imu import ImuSample

PLACE = Place()
DT_S = 0.004
NED_FROM_ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_FROM_FLU = np.diag([1, -1, -1])
angles = st.floats(-math.pi, math.pi)
tilts = st.floats(-1.5, 1.5)


def attitude(yaw: float, pitch: float, roll: float) -> tuple[Rotation, tuple]:
    """``ned_from_frd`` by the aerospace angles, and our ``world_from_body`` of the same."""
    ned_from_frd = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    enu_from_flu = Rotation.from_matrix(NED_FROM_ENU.T @ ned_from_frd.as_matrix() @ FRD_FROM_FLU)
    x, y, z, w = enu_from_flu.as_quat()
    return ned_from_frd, (w, x, y, z)


def read(q, force_world=(0.0, 0.0, 9.81), rates_flu=(0.0, 0.0, 0.0), t_ns=0) -> Reading:
    """A reading at a specific force in ENU and rates in FLU."""
    w, x, y, z = q
    force_flu = Rotation.from_quat([x, y, z, w]).inv().apply(force_world)
    sample = ImuSample(tuple(DT_S * force_flu), tuple(DT_S * np.array(rates_flu)), DT_S)
    return Instruments(PLACE, 0).read(t_ns, sample, q, 1.5)


def test_at_rest_and_level_the_accelerometer_says_minus_g_down():
    """PX4's convention: (0, 0, -9.81) in FRD."""
    _, q = attitude(0.7, 0.0, 0.0)
    assert read(q).force_frd == pytest.approx((0.0, 0.0, -9.81), abs=1e-12)


def test_a_nose_that_is_up_is_felt_ahead():
    """Pitched up by 30 degrees at rest, half of g pushes from behind; rolled right, from the left.

    The accelerometer feels what holds it: with the nose up, a force ahead; with the right wing
    down, one to the left.
    """
    _, q = attitude(0.0, math.radians(30.0), 0.0)
    assert read(q).force_frd == pytest.approx((4.905, 0.0, -9.81 * math.sqrt(0.75)), abs=1e-9)
    _, q = attitude(0.0, 0.0, math.radians(30.0))
    assert read(q).force_frd == pytest.approx((0.0, -4.905, -9.81 * math.sqrt(0.75)), abs=1e-9)


@given(angles, tilts, angles)
def test_forces_and_field_are_turned_as_scipy_turns_them(yaw, pitch, roll):
    """Gravity and the Earth's field of any attitude, by the aerospace angles in NED."""
    ned_from_frd, q = attitude(yaw, pitch, roll)
    reading = read(q)
    assert reading.force_frd == pytest.approx(ned_from_frd.inv().apply([0, 0, -9.81]), abs=1e-9)
    field_ned = NED_FROM_ENU @ PLACE.field_world
    expected = ned_from_frd.inv().apply(field_ned)
    assert reading.field_frd == pytest.approx(expected, abs=6 * FIELD_NOISE_GAUSS)


@pytest.mark.parametrize("heading_deg", [0.0, 45.0, 90.0, 180.0, -120.0])
def test_the_compass_tells_the_heading(heading_deg):
    """Level, the field's direction and the declination give the heading, clockwise from north."""
    _, q = attitude(math.radians(heading_deg), 0.0, 0.0)
    x, y, _ = read(q).field_frd
    heading = math.degrees(math.atan2(-y, x)) + PLACE.declination_deg
    assert math.sin(math.radians(heading - heading_deg)) == pytest.approx(0.0, abs=0.02)
    assert math.cos(math.radians(heading - heading_deg)) > 0.9


def test_rates_turn_right_and_down():
    """Turning left (FLU z up) is a negative yaw rate, nose down (FLU y left) a negative pitch."""
    _, q = attitude(0.0, 0.0, 0.0)
    assert read(q, rates_flu=(0.1, 0.2, 0.3)).rates_frd == pytest.approx((0.1, -0.2, -0.3))


def test_the_barometer_knows_the_height_above_the_sea():
    """Pressure, its height and the temperature of 488 m and a half."""
    _, q = attitude(0.0, 0.0, 0.0)
    air = read(q).air
    true = air_at(PLACE.altitude_m + 1.5)
    assert air.pressure_hpa == pytest.approx(true.pressure_hpa, abs=6 * PRESSURE_NOISE_HPA)
    assert air.altitude_m == pytest.approx(PLACE.altitude_m + 1.5, abs=0.6)
    assert air.temperature_c == pytest.approx(true.temperature_c)


def test_compass_and_barometer_are_slower_and_never_say_the_same_twice():
    """50 Hz beside the IMU's 250; a sensor that repeats itself would be taken for broken."""
    instruments, (_, q) = Instruments(PLACE, 4), attitude(0.0, 0.0, 0.0)
    still = ImuSample((0.0, 0.0, 9.81 * DT_S), (0.0, 0.0, 0.0), DT_S)
    readings = [instruments.read(i * 4_000_000, still, q, 0.0) for i in range(500)]
    seen = [r for r in readings if r.field_frd is not None]
    assert [r.t_ns % SLOW_NS for r in seen] == [0] * 100
    assert all((r.air is None) == (r.field_frd is None) for r in readings)
    assert len({r.field_frd for r in seen}) == len({r.air for r in seen}) == 100
    assert np.std([r.air.pressure_hpa for r in seen]) == pytest.approx(PRESSURE_NOISE_HPA, rel=0.3)


def test_a_seed_is_a_noise():
    """The same seed says the same, another one says something else."""
    _, q = attitude(0.0, 0.0, 0.0)
    still = ImuSample((0.0, 0.0, 9.81 * DT_S), (0.0, 0.0, 0.0), DT_S)
    first, same, other = (Instruments(PLACE, seed).read(0, still, q, 0.0) for seed in (1, 1, 2))
    assert first == same
    assert first.field_frd != other.field_frd
