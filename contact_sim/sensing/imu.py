"""The inertial unit: what speed and angle the body gained since the last sample, biased and noisy.

As in PX4, a sample is an integral over its time and not a value at a moment: a board that hits the
tip between two samples is felt in full, and nothing folds into lower frequencies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from contact_sim.noise import normals
from contact_sim.vehicle.body import BodyState
from drone_client.bounds import check_bounds
from drone_client.cbf.vector import Vec3
from rgbd_wire.quaternion import from_vector, product, rotate_back

GRAVITY_MPS2 = 9.81

_BOUNDS: dict[str, tuple[float, float]] = {
    "accel_noise": (0.0, 0.1),
    "accel_bias_mps2": (0.0, 1.0),
    "accel_walk": (0.0, 0.1),
    "gyro_noise": (0.0, 0.1),
    "gyro_bias_radps": (0.0, 0.1),
    "gyro_walk": (0.0, 0.01),
}


@dataclass(frozen=True, slots=True)
class ImuSettings:
    """Errors of a MEMS unit on soft mounts, per axis, vibration included.

    Raises:
        ValueError: a value is out of its bounds.
    """

    accel_noise: float = 0.002
    """[m/s2 / sqrt(Hz)]: 0.03 m/s2 in a sample of 4 ms."""
    accel_bias_mps2: float = 0.02
    """Spread of what calibration left at the start."""
    accel_walk: float = 0.001
    """[m/s2 / sqrt(s)]"""
    gyro_noise: float = 0.00015
    """[rad/s / sqrt(Hz)]"""
    gyro_bias_radps: float = 0.002
    gyro_walk: float = 0.00005
    """[rad/s / sqrt(s)]"""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)


class ImuSample(NamedTuple):
    """What was gained over ``dt_s``."""

    speed_body: Vec3
    """Integral of the specific force [m/s]: at rest, g upwards."""
    angle_body: Vec3
    """Integral of the rates [rad]."""
    dt_s: float


class Imu:
    """Makes samples of the true motion."""

    def __init__(self, settings: ImuSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        a, g = settings.accel_bias_mps2, settings.gyro_bias_radps
        self._accel_bias: list[float] = (a * rng.standard_normal(3)).tolist()
        self._gyro_bias: list[float] = (g * rng.standard_normal(3)).tolist()
        self._normal = normals(rng)

    @property
    def biases(self) -> tuple[Vec3, Vec3]:
        """Of the acceleration [m/s2] and of the rates [rad/s], now."""
        a, b, c = self._accel_bias
        p, q, r = self._gyro_bias
        return (a, b, c), (p, q, r)

    def sample(self, before: BodyState, now: BodyState, dt_s: float) -> ImuSample:
        """The sample of the time between two states of the body.

        Args:
            before: at its begin.
            now: at its end.
            dt_s: how long it was.
        """
        px, py, pz = before.rates_body
        qx, qy, qz = now.rates_body
        rates = 0.5 * (px + qx), 0.5 * (py + qy), 0.5 * (pz + qz)
        half_s = 0.5 * dt_s
        turn = from_vector((half_s * rates[0], half_s * rates[1], half_s * rates[2]))
        middle = product(before.q_world_from_body, turn)
        ux, uy, uz = before.velocity_world
        vx, vy, vz = now.velocity_world
        speed = rotate_back(middle, (vx - ux, vy - uy, vz - uz + GRAVITY_MPS2 * dt_s))
        s, normal, root = self._settings, self._normal, math.sqrt(dt_s)
        accel_bias, gyro_bias = self._accel_bias, self._gyro_bias
        for axis in (0, 1, 2):
            accel_bias[axis] += s.accel_walk * root * next(normal)
            gyro_bias[axis] += s.gyro_walk * root * next(normal)
        ka, kg = s.accel_noise * root, s.gyro_noise * root
        return ImuSample(
            (
                speed[0] + accel_bias[0] * dt_s + ka * next(normal),
                speed[1] + accel_bias[1] * dt_s + ka * next(normal),
                speed[2] + accel_bias[2] * dt_s + ka * next(normal),
            ),
            (
                (rates[0] + gyro_bias[0]) * dt_s + kg * next(normal),
                (rates[1] + gyro_bias[1]) * dt_s + kg * next(normal),
                (rates[2] + gyro_bias[2]) * dt_s + kg * next(normal),
            ),
            dt_s,
        )
