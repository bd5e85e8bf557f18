"""One simulated approach: real guidance, safety filter and target filter, a drone that lags.

The drone follows velocities and yaw rates with a first-order lag, and holds each command for one
period. It sees the target late, with noise, and composes what it saw with its own pose at the
exposure; its odometry drifts. It is a model for the mathematics, not for the aerodynamics.
"""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple, cast

import numpy as np

from drone_client.airframe import Airframe
from drone_client.cbf import FilterInput, FilterSettings, KeepOut, SafeCommand, filter_command
from drone_client.cbf.keep_out import Rotation, Stance, gaps_m
from drone_client.cbf.vector import ZERO, Vec3, moved
from drone_client.guidance import GuidanceSettings, guide
from drone_client.target import (
    TargetEstimate,
    TargetMeasurement,
    drift_covariance,
    measure,
    update,
)
from rgbd_wire.geometry import Pose, rotation_from_vector

AIRFRAME = Airframe()
ARM_M = float(AIRFRAME.body_from_tip.translation[0])
CAMERA_M = tuple(AIRFRAME.body_from_camera.translation[[0, 2]].tolist())
"""Of the camera in the body, forward and up."""
NS = 1_000_000_000
DRIFT_MPS, DRIFT_RADPS = np.sqrt(np.diag(drift_covariance(NS))[[0, 3]]).tolist()
"""What the target filter counts for a second of odometry..."""
_A_METRE_AHEAD = Pose(np.array([1.0, 0.0, 0.0]), Pose.identity().q_wxyz)
_EXACTLY_SEEN = measure(Pose.identity(), _A_METRE_AHEAD, np.zeros((6, 6)), 0).covariance
ODOMETRY_SIGMA_M, ODOMETRY_SIGMA_RAD = np.sqrt(np.diag(_EXACTLY_SEEN)[[0, 3]]).tolist()
"""...and for the camera's own pose at an exposure."""


@dataclass(frozen=True)
class World:
    """What the drone and its eyes are like."""

    lag_s: float = 0.3
    delay_s: float = 0.15
    """From the exposure until the result can be used."""
    rate_hz: float = 15.0
    noise_m: float = 0.01
    """Standard deviation of a measured position along each axis..."""
    noise_per_m: float = 0.0
    """...and what is added to it per square metre of range: the depth camera's."""
    noise_rad: float = 0.01
    drift_mps: float = 0.01
    """How fast the odometry drifts, in a direction that is drawn once: what the filter counts."""
    seconds: float = 30.0
    quick_eyes: bool = False
    """The target filter's arithmetic for one axis instead of the real one."""

    def sigma_m(self, range_m: float) -> float:
        """Standard deviation of a measured position along each axis."""
        return self.noise_m + self.noise_per_m * range_m * range_m


@dataclass(frozen=True)
class Start:
    """Where and how a flight begins, at rest."""

    tip: Vec3
    """In the target's true frame [m], which is the world's."""
    yaw_off_rad: float
    seed: int
    link_lost_s: float = math.inf
    """No exposure after this gives a result."""


class Tick(NamedTuple):
    """The truth at one tick, and the command that was given."""

    t_s: float
    tip: Vec3
    velocity: Vec3
    """Of the tip [m/s]."""
    age_ns: int
    command: SafeCommand
    tip_command: Vec3
    """Tip velocity that the command asks for [m/s]; in the target's estimated frame."""


@dataclass
class Flight:
    """What became of one approach."""

    touch: Tick | None = None
    """First tick with the true tip in or behind the board's plane."""
    outside_m: float = -math.inf
    """Behind the plane, by how much the tip was beside the mouth at worst."""
    least_gap_m: float = math.inf
    """Of all parts and keep-outs, without clearance and error ball."""
    last: Tick | None = None
    ticks: list[Tick] = field(default_factory=list)
    """All of them, where they were asked for."""


class Seen(NamedTuple):
    """The estimate in plain numbers: looked at on every tick, changed with every result."""

    origin: Vec3
    rows: Rotation
    """``target_from_world``."""
    sigma_m: float
    range_m: float
    t_ns: int


class _Sight(NamedTuple):
    """What guidance looks at of ``target_from_tip``, without building a pose at every tick."""

    translation: Vec3
    rotation: np.ndarray  # (3, 1), its x axis


def seen(estimate: TargetEstimate) -> Seen:
    """An estimate, ready for many ticks."""
    pose = estimate.world_from_target
    ox, oy, oz = pose.translation.tolist()
    rx, ry, rz = pose.rotation.T.tolist()
    rows = (tuple(rx), tuple(ry), tuple(rz))
    return Seen(
        (ox, oy, oz),
        cast(Rotation, rows),
        estimate.seen_sigma_m,
        estimate.range_m,
        estimate.t_capture_ns,
    )


def tick(
    known: Seen,
    body: Vec3,
    yaw: float,
    now_ns: int,
    guidance: GuidanceSettings,
    limits: FilterSettings,
    keep_outs: tuple[KeepOut, ...] = (),
) -> tuple[SafeCommand, Vec3, Vec3]:
    """What ``control.decide`` decides for a level body, in plain numbers.

    Returns:
        The command, the velocity of the body in the world, the wanted one of the tip.
    """
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = known.rows
    ox, oy, oz = known.origin
    cos, sin = math.cos(yaw), math.sin(yaw)
    dx, dy, dz = body[0] + ARM_M * cos - ox, body[1] + ARM_M * sin - oy, body[2] - oz
    tip = (
        ax * dx + ay * dy + az * dz,
        bx * dx + by * dy + bz * dz,
        cx * dx + cy * dy + cz * dz,
    )
    axis = (ax * cos + ay * sin, bx * cos + by * sin, cx * cos + cy * sin)
    up = (az, bz, cz)
    wish = guide(cast(Pose, _Sight(tip, np.array([axis]).T)), guidance, up)
    inp = FilterInput(
        tip,
        wish.velocity_tip_target,
        wish.yaw_rate_radps,
        (ARM_M * axis[0], ARM_M * axis[1], ARM_M * axis[2]),
        up,
        now_ns - known.t_ns,
        known.range_m,
        known.sigma_m,
    )
    if keep_outs:
        side = (ay * cos - ax * sin, by * cos - bx * sin, cy * cos - cx * sin)
        inp = FilterInput(
            *(getattr(inp, name) for name in FilterInput.__slots__[:9]),
            keep_outs,
            tuple(zip(axis, side, up, strict=True)),
            known.rows,
            (
                -(ax * ox + ay * oy + az * oz),
                -(bx * ox + by * oy + bz * oz),
                -(cx * ox + cy * oy + cz * oz),
            ),
        )
    safe = filter_command(inp, limits)
    ux, uy, uz = safe.velocity_body_target
    world = (ax * ux + bx * uy + cx * uz, ay * ux + by * uy + cy * uz, az * ux + bz * uy + cz * uz)
    return safe, world, wish.velocity_tip_target


def fly(
    start: Start,
    world: World,
    limits: FilterSettings,
    guidance: GuidanceSettings,
    keep_outs: tuple[KeepOut, ...] = (),
    keep_ticks: bool = False,
    ends_pressed: bool = True,
) -> Flight:
    """Fly until the time is up, or the tip has pressed 15 mm or touched a second ago.

    Args:
        start: Where, and which noise.
        world: Drone and eyes.
        limits: The safety filter's.
        guidance: The guidance's.
        keep_outs: Planes that the level body stays clear of.
        keep_ticks: Whether every tick is kept.
        ends_pressed: Whether contact ends the flight; without it the guidance goes on pressing.
    """
    rng, flight = random.Random(start.seed), Flight()
    eyes = QuickEyes(world, rng) if world.quick_eyes else Eyes(world, rng)
    period, mouth = limits.period_s, limits.funnel.r_c_m
    follow = 1.0 - math.exp(-period / world.lag_s)
    drift = _direction(rng, world.drift_mps)
    yaw, yaw_rate = math.pi + start.yaw_off_rad, 0.0
    tx, ty, tz = start.tip
    bx, by, bz = tx - ARM_M * math.cos(yaw), ty - ARM_M * math.sin(yaw), tz
    vx = vy = vz = 0.0
    known: Seen | None = None
    for n in range(round(world.seconds / period)):
        t = n * period
        now_ns = round(t * NS)
        off = (drift[0] * t, drift[1] * t, drift[2] * t)
        if t <= start.link_lost_s:
            eyes.look(now_ns, (bx, by, bz), yaw, off)
        known = eyes.newest(now_ns, known)
        cos, sin = math.cos(yaw), math.sin(yaw)
        tip = (bx + ARM_M * cos, by + ARM_M * sin, bz)
        command_world: Vec3 = (0.0, 0.0, 0.0)
        if known is not None:
            seen_at = (bx + off[0], by + off[1], bz + off[2])
            safe, command_world, _ = tick(known, seen_at, yaw, now_ns, guidance, limits, keep_outs)
            now = Tick(
                t,
                tip,
                (vx - yaw_rate * ARM_M * sin, vy + yaw_rate * ARM_M * cos, vz),
                now_ns - known.t_ns,
                safe,
                _tip_command(safe, known, cos, sin),
            )
            if keep_ticks:
                flight.ticks.append(now)
            if _take(now, flight, mouth) and ends_pressed:
                break
        if keep_outs:
            stance = Stance(
                tip,
                (ARM_M * cos, ARM_M * sin, 0.0),
                (0.0, 0.0, 1.0),
                ((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)),
            )
            for keep_out in keep_outs:
                gap = min(gaps_m(keep_out, stance, 0.0)) + keep_out.clearance_m
                flight.least_gap_m = min(flight.least_gap_m, gap)
        rate = 0.0 if known is None else safe.yaw_rate_radps
        wx, wy, wz = command_world
        vx, vy, vz = vx + follow * (wx - vx), vy + follow * (wy - vy), vz + follow * (wz - vz)
        yaw_rate += follow * (rate - yaw_rate)
        bx, by, bz = bx + period * vx, by + period * vy, bz + period * vz
        yaw += period * yaw_rate
    return flight


def _take(now: Tick, flight: Flight, mouth_m: float) -> bool:
    """Write a tick down; whether the tip has been pressed home."""
    flight.last = now
    x, y, z = now.tip
    if x < 0.0:
        flight.outside_m = max(flight.outside_m, math.hypot(y, z) - mouth_m)
        if flight.touch is None:
            flight.touch = now
    if flight.touch is None:
        return False
    return x <= -0.015 or now.t_s >= flight.touch.t_s + 1.0


def _tip_command(safe: SafeCommand, known: Seen, cos: float, sin: float) -> Vec3:
    """Tip velocity of a command in the estimated target's frame: the body's and the swing."""
    w = safe.yaw_rate_radps * ARM_M
    ux, uy, uz = safe.velocity_body_target
    (ax, ay, _), (bx, by, _), (cx, cy, _) = known.rows
    return (
        ux + w * (ay * cos - ax * sin),
        uy + w * (by * cos - bx * sin),
        uz + w * (cy * cos - cx * sin),
    )


class Eyes:
    """Late and noisy results through the real target filter."""

    def __init__(self, world: World, rng: random.Random) -> None:
        self._world, self._rng = world, rng
        self._period_ns, self._delay_ns = round(NS / world.rate_hz), round(world.delay_s * NS)
        self._due_ns = -round(rng.random() * self._period_ns)
        self._under_way: deque[TargetMeasurement] = deque()
        self._estimate: TargetEstimate | None = None

    def look(self, now_ns: int, body: Vec3, yaw: float, off: Vec3) -> None:
        """Expose a frame, if one is due: the truth, what odometry says, and noise."""
        if now_ns < self._due_ns:
            return
        self._due_ns += self._period_ns
        self._under_way.append(self._measured(now_ns, body, yaw, off))

    def newest(self, now_ns: int, known: Seen | None) -> Seen | None:
        """What is known after all results that have arrived."""
        while self._under_way and self._under_way[0].t_capture_ns + self._delay_ns <= now_ns:
            self._estimate, _ = update(self._estimate, self._under_way.popleft())
            known = seen(self._estimate)
        return known

    def _measured(self, now_ns: int, body: Vec3, yaw: float, off: Vec3) -> TargetMeasurement:
        turn = np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
        true = Pose(np.array(body), turn) @ AIRFRAME.body_from_camera
        camera_from_target = true.inverse()
        range_m = math.sqrt(sum(c * c for c in camera_from_target.translation.tolist()))
        sigma, turned = self._world.sigma_m(range_m), self._world.noise_rad
        noise = np.array(_gaussian(self._rng, sigma))
        tilt = rotation_from_vector(np.array(_gaussian(self._rng, turned)))
        measured = Pose.from_rotation(
            tilt @ camera_from_target.rotation, camera_from_target.translation + noise
        )
        odometry = Pose(true.translation + np.array(off), true.q_wxyz)
        return measure(odometry, measured, np.diag([sigma**2] * 3 + [turned**2] * 3), now_ns)


class QuickEyes:
    """The same with the target filter's arithmetic for one axis, for very many flights.

    Place and attitude are two filters of one variance each, and the share of the attitude in the
    place's doubt is counted along every axis: a little more doubt than the real one has.
    """

    def __init__(self, world: World, rng: random.Random) -> None:
        self._world, self._rng = world, rng
        self._period_ns, self._delay_ns = round(NS / world.rate_hz), round(world.delay_s * NS)
        self._due_ns = -round(rng.random() * self._period_ns)
        self._under_way: deque[tuple[int, Vec3, Vec3, float]] = deque()
        self._at: Vec3 = ZERO
        self._turned: Vec3 = ZERO
        self._variances: tuple[float, float] | None = None
        self._t_ns = 0

    def look(self, now_ns: int, body: Vec3, yaw: float, off: Vec3) -> None:
        """Expose a frame, if one is due."""
        if now_ns < self._due_ns:
            return
        self._due_ns += self._period_ns
        cx, cz = CAMERA_M
        eye = (body[0] + cx * math.cos(yaw), body[1] + cx * math.sin(yaw), body[2] + cz)
        range_m = math.sqrt(eye[0] ** 2 + eye[1] ** 2 + eye[2] ** 2)
        at = moved(off, _gaussian(self._rng, self._world.sigma_m(range_m)))
        turned = _gaussian(self._rng, self._world.noise_rad)
        self._under_way.append((now_ns, at, turned, range_m))

    def newest(self, now_ns: int, known: Seen | None) -> Seen | None:
        """What is known after all results that have arrived."""
        while self._under_way and self._under_way[0][0] + self._delay_ns <= now_ns:
            t_ns, at, turned, range_m = self._under_way.popleft()
            by_attitude = (ODOMETRY_SIGMA_RAD * range_m) ** 2
            place = self._world.sigma_m(range_m) ** 2 + ODOMETRY_SIGMA_M**2 + by_attitude
            attitude = self._world.noise_rad**2 + ODOMETRY_SIGMA_RAD**2
            if self._variances is None:
                self._at, self._turned, self._variances = at, turned, (place, attitude)
            else:
                dt = (t_ns - self._t_ns) / NS
                prior = self._variances[0] + (DRIFT_MPS * dt) ** 2
                gain = prior / (prior + place)
                self._at = moved(self._at, moved(at, self._at, -1.0), gain)
                prior_turn = self._variances[1] + (DRIFT_RADPS * dt) ** 2
                gain_turn = prior_turn / (prior_turn + attitude)
                self._turned = moved(self._turned, moved(turned, self._turned, -1.0), gain_turn)
                self._variances = gain * place, gain_turn * attitude
            self._t_ns = t_ns
            rows = _rows(self._turned)
            known = Seen(self._at, rows, math.sqrt(self._variances[0]), range_m, t_ns)
        return known


def _rows(turned: Vec3) -> Rotation:
    """``target_from_world`` of a target that is turned by a small rotation vector."""
    x, y, z = turned
    angle = math.sqrt(x * x + y * y + z * z)
    a, b = (math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2) if angle > 1e-9 else (1, 0.5)
    diagonal = 1.0 - b * angle**2
    return (
        (diagonal + b * x * x, b * x * y + a * z, b * x * z - a * y),
        (b * x * y - a * z, diagonal + b * y * y, b * y * z + a * x),
        (b * x * z + a * y, b * y * z - a * x, diagonal + b * z * z),
    )


def _gaussian(rng: random.Random, sigma: float) -> Vec3:
    return rng.gauss(0.0, sigma), rng.gauss(0.0, sigma), rng.gauss(0.0, sigma)


def _direction(rng: random.Random, length: float) -> Vec3:
    x, y, z = (rng.gauss(0.0, 1.0) for _ in range(3))
    k = length / math.sqrt(x * x + y * y + z * z)
    return k * x, k * y, k * z
