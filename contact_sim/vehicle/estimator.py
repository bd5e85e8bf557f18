"""What EKF2 would make of IMU, VIO and height: where the autopilot believes the vehicle is.

The IMU carries the state on 250 times a second; samples of the VIO, however late, correct it by
what was believed at *their* time. As in PX4 with the project's parameters (``EKF2_EV_CTRL``: place
and heading, not velocity), the velocity follows from place and IMU. A place that does not fit is
refused by a gate; when nothing has fitted for a second, or the source itself counts a reset, the
estimate starts again there and counts a reset of its own. Without samples it goes on by the IMU
alone, and knows less and less.

The covariance is kept where it matters for that: place, velocity and acceleration bias along the
level, the same upright, angle and gyro bias; not between these three groups.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from contact_sim.sensing.imu import ImuSample
from contact_sim.vehicle.covariance import AngleCovariance, AxisCovariance
from contact_sim.vehicle.history import Believed, History
from drone_client.bounds import check_bounds
from drone_client.cbf.vector import ZERO, Vec3
from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.geometry import Array, Pose, vec3
from rgbd_wire.quaternion import (
    Quaternion,
    conjugate,
    from_vector,
    product,
    rotate,
    rotate_back,
    to_vector,
)

GRAVITY_MPS2 = 9.81

_BOUNDS: dict[str, tuple[float, float]] = {
    "ekf2_acc_noise": (0.01, 1.0),
    "ekf2_gyr_noise": (0.0001, 0.1),
    "ekf2_acc_b_noise": (0.0, 0.1),
    "ekf2_gyr_b_noise": (0.0, 0.01),
    "ekf2_evp_noise_m": (0.01, 1.0),
    "ekf2_eva_noise_rad": (0.01, 0.5),
    "ekf2_rng_noise_m": (0.01, 1.0),
    "ekf2_evp_gate": (1.0, 20.0),
    "ekf2_hdg_gate": (1.0, 20.0),
    "filter_period_s": (0.002, 0.02),
    "smoothing_hz": (1.0, 100.0),
    "ev_timeout_ns": (100_000_000, 10_000_000_000),
    "ekf2_noaid_tout_ns": (500_000_000, 10_000_000_000),
}


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """Under PX4's names where it has them; defaults as in the project's parameter file, or PX4's.

    Raises:
        ValueError: a value is out of its bounds.
    """

    ekf2_acc_noise: float = 0.35
    """[m/s2], in one step of ``filter_period_s``."""
    ekf2_gyr_noise: float = 0.015
    """[rad/s], the same."""
    ekf2_acc_b_noise: float = 0.003
    """How fast a bias may walk [m/s3]."""
    ekf2_gyr_b_noise: float = 0.001
    """[rad/s2]"""
    ekf2_evp_noise_m: float = 0.03
    ekf2_eva_noise_rad: float = 0.05
    ekf2_rng_noise_m: float = 0.03
    ekf2_evp_gate: float = 5.0
    """So many standard deviations of what is expected may a place be off."""
    ekf2_hdg_gate: float = 2.6
    filter_period_s: float = 0.008
    height_by_lidar: bool = False
    """``EKF2_HGT_REF`` 2: ranges that look down give the height, over level ground, and the VIO
    does not."""
    smoothing_hz: float = 10.0
    """Of the acceleration that the velocity loop is told."""
    ev_timeout_ns: int = 1_000_000_000
    """After so long without a place that fits, the next one is believed."""
    ekf2_noaid_tout_ns: int = 5_000_000_000
    """So long it goes on by the IMU alone before it says that it knows no place."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What the autopilot says of the vehicle, in the odometry's world."""

    t_ns: int
    world_from_body: Pose
    velocity_world: Array  # (3,) [m/s]
    resets: int
    """How often it has jumped on purpose."""
    valid: bool
    """Something has told it its place within the last seconds."""
    sigma_m: float
    """Standard deviation of each level coordinate, as it believes."""


class Estimator:
    """Carried on by ``propagate``, corrected by ``feed``. Not thread-safe."""

    def __init__(
        self,
        settings: EstimatorSettings,
        t_ns: int,
        world_from_body: Pose,
        accel_bias: Vec3 = ZERO,
        gyro_bias: Vec3 = ZERO,
    ) -> None:
        """Begin at rest.

        Args:
            settings: what it thinks of its sensors.
            t_ns: now.
            world_from_body: a place that is known.
            accel_bias: what it has learned of the IMU until now [m/s2].
            gyro_bias: the same [rad/s].
        """
        self.settings = settings
        self.t_ns = t_ns
        self.position: Vec3 = vec3(world_from_body.translation)
        self.velocity: Vec3 = ZERO
        w, x, y, z = world_from_body.q_wxyz.tolist()
        self.q: Quaternion = (w, x, y, z)
        self.rates: Vec3 = ZERO
        """[rad/s], without the bias that is known."""
        self.acceleration: Vec3 = ZERO
        """Smoothed, in the world [m/s2]."""
        self.resets = 0
        self.refused = 0
        """Samples that did not fit, came too late or were no numbers."""
        self._gyro_bias = gyro_bias
        self._accel_bias = accel_bias
        self._level = AxisCovariance(0.005, 0.02, 0.01)
        self._upright = AxisCovariance(0.005, 0.02, 0.01)
        self._angle = AngleCovariance(0.005, 0.0005)
        period_s = settings.filter_period_s
        self._walks = (
            settings.ekf2_acc_noise**2 * period_s,
            settings.ekf2_acc_b_noise**2 * period_s,
            settings.ekf2_gyr_noise**2 * period_s,
            settings.ekf2_gyr_b_noise**2 * period_s,
        )
        """How fast the variances of velocity, its bias, angle and its bias grow, per second."""
        self._moved: Vec3 = ZERO
        self._turned: Vec3 = ZERO
        self._fused_ns = t_ns
        self._source_resets: int | None = None
        self._ground_m: float | None = None
        self._history = History()
        self._history.remember(self._now())

    def estimate(self) -> Estimate:
        """What is believed now."""
        return Estimate(
            self.t_ns,
            Pose(np.array(self.position), np.array(self.q)),
            np.array(self.velocity),
            self.resets,
            self.t_ns - self._fused_ns <= self.settings.ekf2_noaid_tout_ns,
            math.sqrt(self._level.pp),
        )

    def propagate(self, t_ns: int, imu: ImuSample) -> None:
        """Carry the state on by one sample of the IMU, to its end at ``t_ns``."""
        dt_s = imu.dt_s
        bx, by, bz = self._gyro_bias
        ax, ay, az = imu.angle_body
        gx, gy, gz = ax - bx * dt_s, ay - by * dt_s, az - bz * dt_s
        self.rates = gx / dt_s, gy / dt_s, gz / dt_s
        half = from_vector((0.5 * gx, 0.5 * gy, 0.5 * gz))
        middle = product(self.q, half)
        self.q = product(middle, half)
        bx, by, bz = self._accel_bias
        sx, sy, sz = imu.speed_body
        ux, uy, uz = rotate(middle, (sx - bx * dt_s, sy - by * dt_s, sz - bz * dt_s))
        uz -= GRAVITY_MPS2 * dt_s
        vx, vy, vz = self.velocity
        px, py, pz = self.position
        self.position = (
            px + dt_s * (vx + 0.5 * ux),
            py + dt_s * (vy + 0.5 * uy),
            pz + dt_s * (vz + 0.5 * uz),
        )
        self.velocity = vx + ux, vy + uy, vz + uz
        share = 1.0 - math.exp(-2.0 * math.pi * self.settings.smoothing_hz * dt_s)
        cx, cy, cz = self.acceleration
        self.acceleration = (
            cx + share * (ux / dt_s - cx),
            cy + share * (uy / dt_s - cy),
            cz + share * (uz / dt_s - cz),
        )
        q_v, q_b, q_a, q_g = self._walks
        self._level.propagate(dt_s, q_v, q_b)
        self._upright.propagate(dt_s, q_v, q_b)
        self._angle.propagate(dt_s, q_a, q_g)
        self.t_ns = t_ns
        self._history.remember(self._now())

    def feed(self, sample: OdometrySample) -> None:
        """Take a pose of the VIO; one that is no number, or older than what is kept, is refused."""
        then = self._history.at(sample.t_ns)
        if then is None or not all(map(math.isfinite, vec3(sample.velocity_world))):
            self.refused += 1
            return
        x, y, z = sample.world_from_body.translation.tolist()
        w, a, b, c = sample.world_from_body.q_wxyz.tolist()
        q: Quaternion = (w, a, b, c)
        said = self._source_resets is not None and sample.resets != self._source_resets
        self._source_resets = sample.resets
        # What would be believed of that time now, after the corrections since.
        off = (
            x - then.position[0] - self._moved[0] + then.moved[0],
            y - then.position[1] - self._moved[1] + then.moved[1],
            z - then.position[2] - self._moved[2] + then.moved[2],
        )
        tx, ty, tz = to_vector(product(q, conjugate(then.q)))
        turn = (
            tx - self._turned[0] + then.turned[0],
            ty - self._turned[1] + then.turned[1],
            tz - self._turned[2] + then.turned[2],
        )
        if said or self.t_ns - self._fused_ns > self.settings.ev_timeout_ns:
            self._start_again(sample, off, (tx, ty, tz))
        elif self._fits(off, turn):
            self._fuse(off, turn)
            self._fused_ns = self.t_ns
        else:
            self.refused += 1

    def feed_range(self, sample: RangeSample) -> None:
        """Take a distance to the ground, where the height comes from it."""
        if not (self.settings.height_by_lidar and sample.looks_down and sample.valid):
            return
        then = self._history.at(sample.t_ns)
        w, x, y, z = self.q
        upright = 1.0 - 2.0 * (x * x + y * y)
        if then is None or upright < 0.7:
            return
        height_m = sample.distance_m * upright
        believed_m = then.position[2] + self._moved[2] - then.moved[2]
        if self._ground_m is None:
            self._ground_m = believed_m - height_m
        off = self._ground_m + height_m - believed_m
        variance = self.settings.ekf2_rng_noise_m**2
        if off * off <= self.settings.ekf2_evp_gate**2 * (self._upright.pp + variance):
            kp, kv, kb = self._upright.correct(variance)
            self._move((0.0, 0.0, kp * off), (0.0, 0.0, kv * off), (0.0, 0.0, kb * off))

    def _fits(self, off: Vec3, turn: Vec3) -> bool:
        s = self.settings
        most = s.ekf2_evp_gate**2 * (self._level.pp + s.ekf2_evp_noise_m**2)
        if off[0] * off[0] > most or off[1] * off[1] > most:
            return False
        upright = s.ekf2_evp_gate**2 * (self._upright.pp + s.ekf2_evp_noise_m**2)
        if not s.height_by_lidar and off[2] * off[2] > upright:
            return False
        x, y, z = turn
        angle = s.ekf2_hdg_gate**2 * (self._angle.aa + s.ekf2_eva_noise_rad**2)
        return x * x + y * y + z * z <= angle

    def _fuse(self, off: Vec3, turn: Vec3) -> None:
        s = self.settings
        variance = s.ekf2_evp_noise_m**2
        x, y, z = off
        kp, kv, kb = self._level.correct(variance)
        up, uv, ub = 0.0, 0.0, 0.0
        if not s.height_by_lidar:
            up, uv, ub = self._upright.correct(variance)
        self._move((kp * x, kp * y, up * z), (kv * x, kv * y, uv * z), (kb * x, kb * y, ub * z))
        ka, kg = self._angle.correct(s.ekf2_eva_noise_rad**2)
        a, b, c = turn
        bias = rotate_back(self.q, (kg * a, kg * b, kg * c))
        gx, gy, gz = self._gyro_bias
        self._gyro_bias = gx + bias[0], gy + bias[1], gz + bias[2]
        self._turn((ka * a, ka * b, ka * c))

    def _move(self, by: Vec3, faster: Vec3, bias_world: Vec3) -> None:
        x, y, z = self.position
        self.position = x + by[0], y + by[1], z + by[2]
        x, y, z = self.velocity
        self.velocity = x + faster[0], y + faster[1], z + faster[2]
        bx, by_, bz = rotate_back(self.q, bias_world)
        x, y, z = self._accel_bias
        self._accel_bias = x + bx, y + by_, z + bz
        x, y, z = self._moved
        self._moved = x + by[0], y + by[1], z + by[2]

    def _turn(self, by: Vec3) -> None:
        self.q = product(from_vector(by), self.q)
        x, y, z = self._turned
        self._turned = x + by[0], y + by[1], z + by[2]

    def _start_again(self, sample: OdometrySample, off: Vec3, turn: Vec3) -> None:
        """Believe the sample, with what was flown since it."""
        self.resets += 1
        x, y, z = self.position
        dz = 0.0 if self.settings.height_by_lidar else off[2]
        self.position = x + off[0], y + off[1], z + dz
        self.q = product(from_vector(turn), self.q)
        self.velocity = vec3(sample.velocity_world)
        variance = self.settings.ekf2_evp_noise_m**2
        self._level.place_known(variance)
        if not self.settings.height_by_lidar:
            self._upright.place_known(variance)
        self._angle.angle_known(self.settings.ekf2_eva_noise_rad**2)
        self._fused_ns = self.t_ns
        self._history.begin(self._now())

    def _now(self) -> Believed:
        return Believed(self.t_ns, self.position, self.q, self._moved, self._turned)
