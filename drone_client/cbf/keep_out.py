"""Where the body may not be: planes that its parts stay clear of (docs/cbf.md, section 10).

Every part turns into the same unknown, the velocity of the tip, so that funnel and keep-outs are
half-spaces of one problem. All parts of one plane share its normal: the strictest is the plane's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, TypeAlias

from drone_client.bounds import check_bounds
from drone_client.cbf.half_space import HalfSpace
from drone_client.cbf.vector import ZERO, Vec3, cross, dot, is_bounded, moved, norm, scaled

Rotation: TypeAlias = tuple[Vec3, Vec3, Vec3]
"""Rows of a rotation matrix, ``a_from_b``."""

LEVEL: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
MAX_KEEP_OUTS = 6
"""Planes at once: with the funnel and the closing speed, eight half-spaces."""
MAX_PARTS = 32
MAX_BODY_M = 5.0
"""Nothing on a drone is further than this from its body; metres are easily mistaken."""
FARTHEST_M = 1e3
UNIT_TOLERANCE = 1e-6

_BOUNDS: dict[str, tuple[float, float]] = {
    "offset_m": (-FARTHEST_M, FARTHEST_M),
    "clearance_m": (0.0, 2.0),
    "uncertainty_m": (0.0, 2.0),
    "alpha": (0.1, 5.0),
}


@dataclass(frozen=True, slots=True)
class BodyPart:
    """A ball or a flat disc that is fixed to the body.

    Raises:
        ValueError: a value is out of its bounds.
    """

    center_body: Vec3
    """[m], FLU."""
    radius_m: float
    axis_body: Vec3 | None = None
    """Unit normal of a disc, such as the one that a propeller sweeps; None: a ball."""

    def __post_init__(self) -> None:
        if not is_bounded(self.center_body, MAX_BODY_M):
            raise ValueError(
                f"BodyPart.center_body = {self.center_body} is not within {MAX_BODY_M:g} m"
            )
        if not 0.0 <= self.radius_m <= MAX_BODY_M:
            raise ValueError(f"BodyPart.radius_m = {self.radius_m} is not in [0, {MAX_BODY_M:g}]")
        if self.axis_body is not None:
            _check_unit("BodyPart.axis_body", self.axis_body)

    def reach_m(self, normal_body: Vec3) -> float:
        """How far it reaches against a direction from its own centre [m]."""
        if self.axis_body is None:
            return self.radius_m
        across = dot(self.axis_body, normal_body)
        return self.radius_m * math.sqrt(max(0.0, 1.0 - across * across))


class PlaneFrame(StrEnum):
    """In which frame a plane stands still."""

    TARGET = "target"
    """Known through the target's pose, with its error ball: the wall that the target hangs on."""
    WORLD = "world"
    """Known in the odometry's world: floor, ceiling, another wall."""


@dataclass(frozen=True, slots=True)
class KeepOut:
    """A plane that parts of the body stay in front of.

    Raises:
        ValueError: a value is out of its bounds.
    """

    name: str
    parts: tuple[BodyPart, ...]
    """For the wall of the target all but the arm, which is there to touch it."""
    normal: Vec3 = (1.0, 0.0, 0.0)
    """Unit length, into the free side. The default is the plane of the target's board."""
    offset_m: float = 0.0
    """Free is where ``normal . p >= offset_m``."""
    frame: PlaneFrame = PlaneFrame.TARGET
    """Of ``normal`` and ``offset_m``."""
    clearance_m: float = 0.10
    """Distance to keep, for what is not modelled: tilting faster than the vehicle moves, bending,
    and the air at a wall."""
    uncertainty_m: float = 0.0
    """How far the plane may be from where it is said to be; for TARGET beside the error ball."""
    alpha: float = 0.8
    """Class-K gain [1/s]: at most ``1/(4 lag)``, so that a vehicle that follows its command with
    a lag (0.3 s) does not overshoot."""

    def __post_init__(self) -> None:
        if not 1 <= len(self.parts) <= MAX_PARTS:
            raise ValueError(
                f"KeepOut {self.name!r} has {len(self.parts)} parts, not 1 to {MAX_PARTS}"
            )
        _check_unit(f"KeepOut {self.name!r}: normal", self.normal)
        check_bounds(self, _BOUNDS, f"KeepOut {self.name!r}: ")


class Stance(NamedTuple):
    """How the body is at one tick; all vectors in frame ``target``."""

    tip: Vec3
    """[m]"""
    lever_arm: Vec3
    """From the body's origin to the tip [m]."""
    up: Vec3
    """The axis that the body yaws about, unit length."""
    target_from_body: Rotation = LEVEL
    """The body's attitude: where its parts are."""
    target_from_world: Rotation = LEVEL
    world_origin: Vec3 = ZERO
    """Origin of the world [m]."""


def gaps_m(keep_out: KeepOut, stance: Stance, delta_m: float) -> list[float]:
    """By how much each part is clear of what the plane demands [m]: its barriers, each affine."""
    normal, offset = _plane(keep_out, stance)
    normal_body = _turned_back(stance.target_from_body, normal)
    room = _room_m(keep_out, stance, normal, offset, delta_m)
    return [
        room + dot(normal_body, part.center_body) - part.reach_m(normal_body)
        for part in keep_out.parts
    ]


def half_spaces(
    keep_outs: Iterable[KeepOut],
    stance: Stance,
    delta_m: float,
    delta_rate_mps: float,
    yaw_rate_radps: float,
    period_s: float,
) -> list[HalfSpace]:
    """The tip velocities that keep every part clear, one half-space a plane, normals of length one.

    With the tip's velocity ``u`` and the yaw rate ``w`` a part at ``c`` from the body's origin
    moves with ``u + w up x (c - r)``. The barrier is affine in the place: what holds at the start
    of the period holds at its end, the arc of a turning part being in the offset.

    Args:
        keep_outs: The planes.
        stance: Of the body now.
        delta_m: Radius of the error ball [m]; counts for the planes known through the target.
        delta_rate_mps: How fast that radius grows [m/s].
        yaw_rate_radps: What the body will turn with.
        period_s: How long the command is held [s].
    """
    spaces = []
    turn = yaw_rate_radps
    for keep_out in keep_outs:
        normal, offset = _plane(keep_out, stance)
        normal_body = _turned_back(stance.target_from_body, normal)
        swing = cross(normal, stance.up)  # n . (up x d) = swing . d
        swing_body = _turned_back(stance.target_from_body, swing)
        swing_tip = dot(swing, stance.lever_arm)
        room = _room_m(keep_out, stance, normal, offset, delta_m)
        needed = -math.inf
        for part in keep_out.parts:
            c = part.center_body
            h = room + dot(normal_body, c) - part.reach_m(normal_body)
            by_turning = turn * (dot(swing_body, c) - swing_tip)
            arc = 0.5 * turn * turn * period_s * norm(c)
            needed = max(needed, arc - by_turning - keep_out.alpha * h)
        if keep_out.frame is PlaneFrame.TARGET:
            needed += delta_rate_mps
        spaces.append(HalfSpace(normal, needed))
    return spaces


def is_rotation(rows: Rotation, tolerance: float) -> bool:
    """Whether three rows are a rotation matrix's, as far as the tolerance goes. Never raises."""
    a, b, c = rows
    if not (is_bounded(a, 2.0) and is_bounded(b, 2.0) and is_bounded(c, 2.0)):
        return False
    wrong = moved(cross(a, b), c, -1.0)
    return (
        abs(norm(a) - 1.0) <= tolerance
        and abs(norm(b) - 1.0) <= tolerance
        and norm(wrong) <= tolerance
    )


def _plane(keep_out: KeepOut, stance: Stance) -> tuple[Vec3, float]:
    """Normal and offset in frame ``target``."""
    if keep_out.frame is PlaneFrame.TARGET:
        return keep_out.normal, keep_out.offset_m
    x, y, z = stance.target_from_world
    n = keep_out.normal
    normal = (dot(x, n), dot(y, n), dot(z, n))
    normal = scaled(normal, 1.0 / norm(normal))
    return normal, keep_out.offset_m + dot(normal, stance.world_origin)


def _room_m(
    keep_out: KeepOut, stance: Stance, normal: Vec3, offset: float, delta_m: float
) -> float:
    """Barrier of a part without extent at the body's origin [m]."""
    body = moved(stance.tip, stance.lever_arm, -1.0)
    room = dot(normal, body) - offset - keep_out.clearance_m - keep_out.uncertainty_m
    return room - delta_m if keep_out.frame is PlaneFrame.TARGET else room


def _turned_back(target_from_body: Rotation, direction: Vec3) -> Vec3:
    """A direction of frame ``target`` in the body's axes."""
    x, y, z = direction
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = target_from_body
    return x * ax + y * bx + z * cx, x * ay + y * by + z * cy, x * az + y * bz + z * cz


def _check_unit(name: str, direction: Vec3) -> None:
    if not (is_bounded(direction, 2.0) and abs(norm(direction) - 1.0) <= UNIT_TOLERANCE):
        raise ValueError(f"{name} = {direction} is not of unit length")
