"""The inertial unit: what it measures, and how wrong it is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_sim.chance import stream
from contact_sim.sensing.imu import Imu, ImuSettings
from contact_sim.vehicle.body import BodyState
from rgbd_wire.quaternion import from_vector

DT_S = 0.004
RIGHT = ImuSettings(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ZERO = (0.0, 0.0, 0.0)
vectors = st.tuples(*[st.floats(-2.0, 2.0)] * 3)


def moving(turn=ZERO, velocity=ZERO, rates=ZERO) -> BodyState:
    return BodyState(ZERO, from_vector(turn), velocity, rates, 0.0, 0.0)


STILL = moving()


@given(vectors, vectors, vectors, vectors)
def test_a_right_unit_measures_specific_force_and_turn(turn, velocity, gained, rates):
    """The gain of speed and g against gravity, in the body's axes in the middle of the time."""
    before = moving(turn, velocity, rates)
    now = moving(turn, tuple(np.add(velocity, gained)), rates)
    sample = Imu(RIGHT, stream(0, "imu")).sample(before, now, DT_S)
    middle = Rotation.from_rotvec(turn) * Rotation.from_rotvec(0.5 * DT_S * np.array(rates))
    force = np.array(gained) + [0.0, 0.0, 9.81 * DT_S]
    assert sample.speed_body == pytest.approx(middle.inv().apply(force), abs=1e-12)
    assert sample.angle_body == pytest.approx(DT_S * np.array(rates))


def test_rates_that_change_are_taken_in_the_mean():
    """From one to three radians a second, the turn is that of two."""
    sample = Imu(RIGHT, stream(0, "imu")).sample(
        moving(rates=(1.0, 0.0, 0.0)), moving(rates=(3.0, 0.0, 0.0)), DT_S
    )
    assert sample.angle_body == pytest.approx((2.0 * DT_S, 0.0, 0.0))


def test_noise_and_bias_are_those_of_the_settings():
    """Over many samples at rest: the spread of white noise, and a bias that is there all along."""
    settings = ImuSettings(accel_walk=0.0, gyro_walk=0.0)
    imu = Imu(settings, stream(1, "imu"))
    samples = [imu.sample(STILL, STILL, DT_S) for _ in range(20_000)]
    speed = np.array([s.speed_body for s in samples]) / DT_S
    angle = np.array([s.angle_body for s in samples]) / DT_S
    accel_bias, gyro_bias = imu.biases
    root = math.sqrt(DT_S)
    assert speed.std(axis=0) == pytest.approx([settings.accel_noise / root] * 3, rel=0.03)
    assert angle.std(axis=0) == pytest.approx([settings.gyro_noise / root] * 3, rel=0.03)
    assert speed.mean(axis=0) == pytest.approx(np.add(accel_bias, [0, 0, 9.81]), abs=1e-3)
    assert angle.mean(axis=0) == pytest.approx(gyro_bias, abs=1e-4)


def test_biases_differ_by_seed_with_the_spread_of_the_settings():
    """What calibration left is drawn for each flight."""
    settings = ImuSettings()
    biases = np.array([Imu(settings, stream(seed, "imu")).biases for seed in range(500)])
    assert biases[:, 0].std() == pytest.approx(settings.accel_bias_mps2, rel=0.1)
    assert biases[:, 1].std() == pytest.approx(settings.gyro_bias_radps, rel=0.1)


def test_biases_walk():
    """After a time they have moved by the root of it."""
    settings = ImuSettings()
    moved = []
    for seed in range(100):
        imu = Imu(settings, stream(seed, "imu"))
        before = imu.biases[0]
        for _ in range(250):
            imu.sample(STILL, STILL, DT_S)
        moved.append(np.subtract(imu.biases[0], before))
    assert np.std(moved) == pytest.approx(settings.accel_walk, rel=0.15)


def test_bad_settings_are_refused():
    """The field at fault is named."""
    with pytest.raises(ValueError, match="gyro_noise"):
        ImuSettings(gyro_noise=-1.0)
