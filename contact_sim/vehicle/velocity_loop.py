"""From a wanted velocity and yaw rate to thrust and torque: the cascade that PX4 flies.

Pure. Velocity PID -> acceleration, within its limits -> direction of the thrust, within the tilt's
-> rates by the way to turn the thrust -> rate PID -> torque. Names are those of PX4's parameters;
sizes are PX4's defaults but for those of the horizontal velocity, whose defaults are made for a
vehicle that flies fast, and for yaw, where an airframe of this size is tuned higher.

Heading is not held, as PX4 does not hold it either when it is told a yaw rate: its rate is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from contact_sim.vehicle.rotors import Effort
from drone_client.bounds import check_bounds
from drone_client.cbf.vector import ZERO, Vec3
from rgbd_wire.quaternion import Quaternion, rotate_back

GRAVITY_MPS2 = 9.81

_BOUNDS: dict[str, tuple[float, float]] = {
    "mpc_xy_vel_p_acc": (1.2, 5.0),
    "mpc_xy_vel_i_acc": (0.0, 60.0),
    "mpc_xy_vel_d_acc": (0.0, 2.0),
    "mpc_z_vel_p_acc": (2.0, 15.0),
    "mpc_z_vel_i_acc": (0.0, 3.0),
    "mpc_z_vel_d_acc": (0.0, 2.0),
    "mpc_xy_vel_max_mps": (0.1, 20.0),
    "mpc_z_vel_max_up_mps": (0.1, 8.0),
    "mpc_z_vel_max_dn_mps": (0.1, 4.0),
    "mpc_acc_hor_max_mps2": (2.0, 15.0),
    "mpc_acc_up_max_mps2": (2.0, 15.0),
    "mpc_acc_down_max_mps2": (2.0, 9.0),
    "mpc_jerk_max_mps3": (0.5, 500.0),
    "mpc_tiltmax_air_rad": (math.radians(5.0), math.radians(89.0)),
    "mpc_thr_min": (0.05, 0.5),
    "mpc_thr_max": (0.5, 1.0),
    "mpc_yawrauto_max_radps": (0.1, 6.3),
    "mc_roll_p": (0.0, 12.0),
    "mc_pitch_p": (0.0, 12.0),
    "mc_rate_max_radps": (0.1, 31.4),
    "mc_rollrate_p": (0.01, 0.5),
    "mc_rollrate_i": (0.0, 1.0),
    "mc_rollrate_d": (0.0, 0.01),
    "mc_yawrate_p": (0.0, 0.6),
    "mc_yawrate_i": (0.0, 1.0),
    "mc_rr_int_lim": (0.0, 1.0),
    "imu_dgyro_cutoff_hz": (5.0, 100.0),
}


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Gains and limits under PX4's names; pitch has those of roll.

    Raises:
        ValueError: a value is out of PX4's bounds.
    """

    mpc_xy_vel_p_acc: float = 3.0
    """PX4's default of 1.8 is made for metres a second and lags 0.7 s; this lags 0.4 s."""
    mpc_xy_vel_i_acc: float = 0.4
    mpc_xy_vel_d_acc: float = 0.2
    mpc_z_vel_p_acc: float = 4.0
    mpc_z_vel_i_acc: float = 2.0
    mpc_z_vel_d_acc: float = 0.0
    mpc_xy_vel_max_mps: float = 12.0
    mpc_z_vel_max_up_mps: float = 3.0
    mpc_z_vel_max_dn_mps: float = 1.5
    mpc_acc_hor_max_mps2: float = 5.0
    mpc_acc_up_max_mps2: float = 4.0
    mpc_acc_down_max_mps2: float = 3.0
    mpc_jerk_max_mps3: float = 30.0
    """How fast the wanted acceleration may change."""
    mpc_tiltmax_air_rad: float = math.radians(45.0)
    mpc_thr_min: float = 0.12
    mpc_thr_max: float = 1.0
    """Shares of what all rotors can do."""
    mpc_yawrauto_max_radps: float = math.radians(60.0)
    mc_roll_p: float = 6.5
    mc_pitch_p: float = 6.5
    mc_rate_max_radps: float = math.radians(220.0)
    mc_rollrate_p: float = 0.15
    mc_rollrate_i: float = 0.2
    mc_rollrate_d: float = 0.003
    mc_yawrate_p: float = 0.4
    mc_yawrate_i: float = 0.1
    mc_rr_int_lim: float = 0.3
    """Of the rate integrals, as torque from -1 to 1."""
    imu_dgyro_cutoff_hz: float = 30.0
    """What a change of the rates is smoothed with."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)


class Craft(NamedTuple):
    """What the loop knows of the vehicle."""

    mass_kg: float
    thrust_max_n: float
    authority_nm: Vec3
    """Torques that a rate loop's 1 stands for."""


class Setpoint(NamedTuple):
    """What the vehicle is told."""

    velocity_world: Vec3 = ZERO
    """[m/s]"""
    yaw_rate_radps: float = 0.0


class Sensed(NamedTuple):
    """What the estimator and the gyro say of the vehicle."""

    q_world_from_body: Quaternion
    velocity_world: Vec3
    acceleration_world: Vec3
    """Smoothed [m/s2]."""
    rates_body: Vec3
    """[rad/s]"""


class LoopState(NamedTuple):
    """What the loop remembers."""

    velocity_integral: Vec3 = ZERO
    """[m/s2]"""
    acceleration_world: Vec3 = ZERO
    """Wanted last [m/s2]."""
    rate_integral: Vec3 = ZERO
    """Torque from -1 to 1."""
    rates_body: Vec3 | None = None
    """At the last step; None: there was none."""
    turn_body: Vec3 = ZERO
    """Smoothed change of the rates [rad/s2]."""


def step(
    state: LoopState,
    wanted: Setpoint,
    sensed: Sensed,
    dt_s: float,
    settings: LoopSettings,
    craft: Craft,
) -> tuple[LoopState, Effort]:
    """The effort until the next step, ``dt_s`` later."""
    acceleration, integral = _velocity(state, wanted, sensed, dt_s, settings)
    thrust_n, aim_body = _thrust(acceleration, sensed.q_world_from_body, settings, craft)
    rates = _attitude(aim_body, wanted.yaw_rate_radps, sensed.q_world_from_body, settings)
    torque, rate_integral, turn = _rates(state, rates, sensed.rates_body, dt_s, settings)
    roll, pitch, yaw = craft.authority_nm
    effort = Effort(thrust_n, (roll * torque[0], pitch * torque[1], yaw * torque[2]))
    return LoopState(integral, acceleration, rate_integral, sensed.rates_body, turn), effort


def _velocity(
    state: LoopState, wanted: Setpoint, sensed: Sensed, dt_s: float, s: LoopSettings
) -> tuple[Vec3, Vec3]:
    """Wanted acceleration in the world, and the integral of the error of the velocity."""
    wx, wy, wz = wanted.velocity_world
    fast = math.hypot(wx, wy)
    if fast > s.mpc_xy_vel_max_mps:
        wx, wy = wx * s.mpc_xy_vel_max_mps / fast, wy * s.mpc_xy_vel_max_mps / fast
    wz = _within(wz, -s.mpc_z_vel_max_dn_mps, s.mpc_z_vel_max_up_mps)
    vx, vy, vz = sensed.velocity_world
    ax, ay, az = sensed.acceleration_world
    ex, ey, ez = wx - vx, wy - vy, wz - vz
    ix, iy, iz = state.velocity_integral

    px = s.mpc_xy_vel_p_acc * ex + ix - s.mpc_xy_vel_d_acc * ax
    py = s.mpc_xy_vel_p_acc * ey + iy - s.mpc_xy_vel_d_acc * ay
    pz = s.mpc_z_vel_p_acc * ez + iz - s.mpc_z_vel_d_acc * az
    most = min(
        s.mpc_acc_hor_max_mps2,
        (GRAVITY_MPS2 - s.mpc_acc_down_max_mps2) * math.tan(s.mpc_tiltmax_air_rad),
    )
    hard = math.hypot(px, py)
    fit = 1.0 if hard <= most else most / hard
    bx, by = fit * px, fit * py
    bz = _within(pz, -s.mpc_acc_down_max_mps2, s.mpc_acc_up_max_mps2)

    # An integral learns nothing from an error that a limit leaves standing (PX4's tracking
    # anti-windup, 2 / P, and no more of what is saturated already).
    unwind = 2.0 / s.mpc_xy_vel_p_acc
    ix += dt_s * s.mpc_xy_vel_i_acc * (ex - unwind * (px - bx))
    iy += dt_s * s.mpc_xy_vel_i_acc * (ey - unwind * (py - by))
    if bz == pz or (pz - bz) * ez < 0.0:
        iz = _within(iz + dt_s * s.mpc_z_vel_i_acc * ez, -GRAVITY_MPS2, GRAVITY_MPS2)

    change = s.mpc_jerk_max_mps3 * dt_s
    lx, ly, lz = state.acceleration_world
    acceleration = (
        _within(bx, lx - change, lx + change),
        _within(by, ly - change, ly + change),
        _within(bz, lz - change, lz + change),
    )
    return acceleration, (ix, iy, iz)


def _thrust(
    acceleration: Vec3, q_world_from_body: Quaternion, s: LoopSettings, craft: Craft
) -> tuple[float, Vec3]:
    """Thrust [N] and, in the body, the direction that it should have."""
    fx, fy, fz = acceleration[0], acceleration[1], acceleration[2] + GRAVITY_MPS2
    level = math.hypot(fx, fy)
    most = fz * math.tan(s.mpc_tiltmax_air_rad)
    if level > most:
        fx, fy, level = fx * most / level, fy * most / level, most
    force = math.sqrt(level * level + fz * fz)
    x, y, z = rotate_back(q_world_from_body, (fx / force, fy / force, fz / force))
    # While it still turns there, only the part along the body's z is asked for: else it climbs.
    thrust_n = craft.mass_kg * force * max(z, 0.1)
    limits = s.mpc_thr_min * craft.thrust_max_n, s.mpc_thr_max * craft.thrust_max_n
    return _within(thrust_n, *limits), (x, y, z)


def _attitude(
    aim_body: Vec3, yaw_rate_radps: float, q_world_from_body: Quaternion, s: LoopSettings
) -> Vec3:
    """Rates [rad/s] that turn the thrust to where it should point, and the heading at its rate."""
    # The shortest turn from the body's z to the aim, twice the vector of its quaternion: as the
    # heading has no setpoint, it is all that PX4's quaternion controller would turn.
    x, y, z = aim_body
    w = math.sqrt(max(0.5 + 0.5 * z, 1e-6))
    roll, pitch = -y / w, x / w
    most = s.mpc_yawrauto_max_radps
    up_x, up_y, up_z = rotate_back(
        q_world_from_body, (0.0, 0.0, _within(yaw_rate_radps, -most, most))
    )
    fast = s.mc_rate_max_radps
    return (
        _within(s.mc_roll_p * roll + up_x, -fast, fast),
        _within(s.mc_pitch_p * pitch + up_y, -fast, fast),
        _within(up_z, -fast, fast),
    )


def _rates(
    state: LoopState, wanted: Vec3, rates: Vec3, dt_s: float, s: LoopSettings
) -> tuple[Vec3, Vec3, Vec3]:
    """Torque from -1 to 1, the integral of the rates' errors, and their smoothed change."""
    p, q, r = rates
    before = state.rates_body or rates
    share = 1.0 - math.exp(-2.0 * math.pi * s.imu_dgyro_cutoff_hz * dt_s)
    tp, tq, tr = state.turn_body
    tp += share * ((p - before[0]) / dt_s - tp)
    tq += share * ((q - before[1]) / dt_s - tq)
    tr += share * ((r - before[2]) / dt_s - tr)

    ep, eq, er = wanted[0] - p, wanted[1] - q, wanted[2] - r
    ip, iq, ir = state.rate_integral
    torque = (
        _within(s.mc_rollrate_p * ep + ip - s.mc_rollrate_d * tp, -1.0, 1.0),
        _within(s.mc_rollrate_p * eq + iq - s.mc_rollrate_d * tq, -1.0, 1.0),
        _within(s.mc_yawrate_p * er + ir, -1.0, 1.0),
    )
    most = s.mc_rr_int_lim
    integral = (
        _within(ip + dt_s * s.mc_rollrate_i * ep, -most, most),
        _within(iq + dt_s * s.mc_rollrate_i * eq, -most, most),
        _within(ir + dt_s * s.mc_yawrate_i * er, -most, most),
    )
    return torque, integral, (tp, tq, tr)


def _within(value: float, low: float, high: float) -> float:
    if value < low:
        return low
    return high if value > high else value  # in half the time of min()
