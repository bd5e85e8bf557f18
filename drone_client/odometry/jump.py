"""Recognises that the odometry's world has moved, and not the robot (docs/odometry.md).

Two samples and the time between them must fit each other: the place follows from the velocities,
the velocity changes no faster than the robot can accelerate, the attitude turns no faster than it
can turn, and the source's own count of resets stands still. Where they do not, everything that was
known in that world is void.

Pure: time is in the samples. No sample makes it raise.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from drone_client.bounds import check_bounds
from drone_client.cbf.vector import ZERO, Vec3, is_bounded, moved, norm
from drone_client.odometry import OdometrySample
from rgbd_wire.geometry import Array, Pose, vec3

NS_PER_S = 1_000_000_000
FARTHEST_M = 1e5
"""A place further from where the odometry began is a fault, not a place."""
FASTEST_MPS = 100.0

_BOUNDS: dict[str, tuple[float, float]] = {
    "position_m": (0.005, 0.5),
    "drift_mps": (0.0, 1.0),
    "acceleration_mps2": (0.5, 50.0),
    "velocity_mps": (0.02, 2.0),
    "speed_mps": (0.1, 20.0),
    "attitude_rad": (0.002, 0.5),
    "yaw_radps": (0.1, 20.0),
    "tilt_radps": (0.1, 20.0),
    "slide_m": (0.01, 0.5),
    "slide_s": (0.05, 2.0),
    "gap_ns": (20_000_000, 2_000_000_000),
    "late_ns": (0, 500_000_000),
}


@dataclass(frozen=True, slots=True)
class JumpSettings:
    """What a robot that flies to touch things can do between two samples.

    Raises:
        ValueError: a value is out of its bounds, or no number.
    """

    position_m: float = 0.05
    """Further from where the velocities lead to, and the place has jumped; beside it, what follows
    for the time between the samples. Seven times the noise of a difference at 5 mm a sample."""
    drift_mps: float = 0.1
    """By how much the source's velocity may be wrong."""
    acceleration_mps2: float = 5.0
    """Half of g: a gentle robot in a gust."""
    velocity_mps: float = 0.25
    """A faster change of velocity than this and the acceleration is a jump of it."""
    speed_mps: float = 2.0
    """How fast the robot can be, where the source tells no velocity."""
    attitude_rad: float = 0.03
    """Turned by more than this and what follows for the time, and the attitude has jumped."""
    yaw_radps: float = 1.0
    """How fast the robot turns about the world's up: twice what it is ever commanded."""
    tilt_radps: float = 3.0
    """How fast it rolls and pitches."""
    slide_m: float = 0.08
    """So far from where the velocities lead to within about ``slide_s``: a jump that an estimator
    behind the source has smoothed."""
    slide_s: float = 0.5
    gap_ns: int = 300_000_000
    """After a longer silence nobody can tell any more whether it jumped: what a robot can do by
    itself in this time hides 19 cm."""
    late_ns: int = 100_000_000
    """A sample that is older than the newest by up to this came late and is left out; one that is
    older by more is of a source that has begun again."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)


class JumpReason(StrEnum):
    """What does not fit."""

    RESET = "reset"
    """The source says so itself."""
    POSITION = "position"
    VELOCITY = "velocity"
    ATTITUDE = "attitude"
    SLIDE = "slide"
    """The place runs away from its own velocity, too fast for drift."""
    GAP = "gap"
    """It was silent for too long."""
    CLOCK = "clock"
    """Its time went back."""
    NOT_A_NUMBER = "not_a_number"
    """It has diverged: a value is not finite, or absurd."""


@dataclass(frozen=True, slots=True)
class Jump:
    """The odometry's world has moved."""

    reason: JumpReason
    t_ns: int
    """Of the sample that shows it, drone's clock: the first of the new world."""
    size: float
    """What was seen, in the unit of ``allowed``: m, m/s, rad, s, or resets."""
    allowed: float

    @property
    def sentence(self) -> str:
        """For people."""
        unit = _UNITS[self.reason]
        if self.reason is JumpReason.NOT_A_NUMBER:
            return "the odometry jumped: a value is not a number, or absurd"
        return (
            f"the odometry jumped ({self.reason}): {self.size:.3g} {unit}, "
            f"at most {self.allowed:.3g} {unit} can be"
        )


_UNITS = {
    JumpReason.RESET: "resets",
    JumpReason.POSITION: "m",
    JumpReason.VELOCITY: "m/s",
    JumpReason.ATTITUDE: "rad",
    JumpReason.SLIDE: "m",
    JumpReason.GAP: "s",
    JumpReason.CLOCK: "s",
    JumpReason.NOT_A_NUMBER: "",
}


class Motion(NamedTuple):
    """One sample, as far as a jump shows in it."""

    t_ns: int
    """Drone's clock."""
    world_from_body: Pose
    velocity_world: Array | None = None  # (3,) [m/s]
    """None: the source tells none."""
    resets: int = 0

    @classmethod
    def of(cls, sample: OdometrySample) -> Motion:
        """That of an odometry sample."""
        return cls(sample.t_ns, sample.world_from_body, sample.velocity_world, sample.resets)


class _Track(NamedTuple):
    """The newest sample that fits, and what the ones before leave open."""

    motion: Motion
    slide_world: Vec3
    """Fading sum of what the velocities do not explain [m]."""


class JumpWatch:
    """Sees each sample once. Not thread-safe."""

    def __init__(self, settings: JumpSettings | None = None) -> None:
        self.left_out = 0
        """Samples that came late, or twice; nothing was learned from them."""
        self.jumps: Counter[JumpReason] = Counter()
        self._settings = settings or JumpSettings()
        self._track: _Track | None = None

    @property
    def newest(self) -> Motion | None:
        """The newest sample that may be used; None: there is none, or the last was no number."""
        return None if self._track is None else self._track.motion

    def see(self, motion: Motion) -> Jump | None:
        """Take the next sample; the jump that it shows, or None.

        After a jump it begins again with this sample. The very first one shows nothing.
        """
        track = self._track
        if not is_sane(motion):
            self._track = None
            if track is None:
                return None
            return self._told(Jump(JumpReason.NOT_A_NUMBER, motion.t_ns, 0.0, 0.0))
        if track is None:
            self._track = _begin(motion)
            return None
        behind_ns = track.motion.t_ns - motion.t_ns
        if 0 <= behind_ns <= self._settings.late_ns and motion.resets == track.motion.resets:
            self.left_out += 1
            return None
        jump, self._track = _step(track, motion, self._settings)
        return None if jump is None else self._told(jump)

    def _told(self, jump: Jump) -> Jump:
        self.jumps[jump.reason] += 1
        return jump


def is_sane(motion: Motion) -> bool:
    """Whether every number of a sample is one, and none absurd."""
    velocity = motion.velocity_world
    if not is_bounded(vec3(motion.world_from_body.translation), FARTHEST_M):
        return False
    return velocity is None or (velocity.shape == (3,) and is_bounded(vec3(velocity), FASTEST_MPS))


def _begin(motion: Motion) -> _Track:
    return _Track(motion, ZERO)


def _step(track: _Track, now: Motion, settings: JumpSettings) -> tuple[Jump | None, _Track]:
    """Hold a sample against the newest one before: the first thing that does not fit."""
    before = track.motion
    dt_s = (now.t_ns - before.t_ns) / NS_PER_S
    for reason, size, allowed in _in_time(before, now, dt_s, settings):
        if not size <= allowed:
            return Jump(reason, now.t_ns, size, allowed), _begin(now)

    off, allowed_m = _off(before, now, dt_s, settings)
    slide = moved(off, track.slide_world, math.exp(-dt_s / settings.slide_s))
    if now.velocity_world is None:
        slide = ZERO
    for reason, size, allowed in (
        (JumpReason.POSITION, norm(off), allowed_m),
        *_in_motion(before, now, dt_s, settings),
        (JumpReason.SLIDE, norm(slide), settings.slide_m),
    ):
        if not size <= allowed:
            return Jump(reason, now.t_ns, size, allowed), _begin(now)
    return None, _Track(now, slide)


class _Check(NamedTuple):
    """What may be at most how much."""

    reason: JumpReason
    size: float
    allowed: float


def _in_time(
    before: Motion, now: Motion, dt_s: float, settings: JumpSettings
) -> tuple[_Check, ...]:
    """Without these, the time between the samples says nothing."""
    return (
        _Check(JumpReason.RESET, abs(now.resets - before.resets), 0.0),
        _Check(JumpReason.CLOCK, max(0.0, -dt_s), 0.0),
        _Check(JumpReason.GAP, dt_s, settings.gap_ns / NS_PER_S),
    )


def _in_motion(
    before: Motion, now: Motion, dt_s: float, settings: JumpSettings
) -> Iterator[_Check]:
    if before.velocity_world is not None and now.velocity_world is not None:
        change_mps = norm(moved(vec3(now.velocity_world), vec3(before.velocity_world), -1.0))
        allowed_mps = settings.velocity_mps + settings.acceleration_mps2 * dt_s
        yield _Check(JumpReason.VELOCITY, change_mps, allowed_mps)
    turn = now.world_from_body.turned_since(before.world_from_body)
    yaw_rad, tilt_rad = abs(turn[2]), math.hypot(turn[0], turn[1])
    yield _Check(JumpReason.ATTITUDE, yaw_rad, settings.attitude_rad + settings.yaw_radps * dt_s)
    yield _Check(JumpReason.ATTITUDE, tilt_rad, settings.attitude_rad + settings.tilt_radps * dt_s)


def _off(before: Motion, now: Motion, dt_s: float, settings: JumpSettings) -> tuple[Vec3, float]:
    """How far the place is from where the velocities lead to [m], and how far it may be."""
    start, end = before.world_from_body.translation, now.world_from_body.translation
    way = moved(vec3(end), vec3(start), -1.0)
    if before.velocity_world is None or now.velocity_world is None:
        return way, settings.position_m + settings.speed_mps * dt_s
    # Between two known velocities an acceleration of at most A leads at most A dt^2 / 4 astray.
    both = moved(vec3(before.velocity_world), vec3(now.velocity_world))
    spread_m = settings.drift_mps * dt_s + 0.25 * settings.acceleration_mps2 * dt_s**2
    return moved(way, both, -0.5 * dt_s), settings.position_m + spread_m
