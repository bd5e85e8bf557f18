"""The rotation about the board's normal, which its circles do not show."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose.conic import CirclePose
from target_pose.lens import project
from target_pose.localisation import RollSource
from target_pose.profiles import gray_values, slopes, strongest_edges
from target_pose.target import Target
from target_pose.tukey import fit_robust
from target_pose.vectors import cross, length, unit

Array: TypeAlias = NDArray[np.float64]

GRAVITY_SIGMA_RAD = math.radians(3.0)
"""An accelerometer in flight, and a board hung by eye."""
ASSUMED_SIGMA_RAD = math.radians(30.0)
UNKNOWN_SIGMA_RAD = math.pi / 2
EDGE_FLOOR_RAD = math.radians(0.3)
"""How square a board is cut to its print."""
MIN_UP_SINE = 0.35
"""Sine of the angle between up and normal under which a board has no upper edge: 20 degrees."""
MIN_BOARD_PX = 24.0
RAYS = 64
SAMPLES = 30
KNOTS = 8
MIN_SLOPE = 1.0
"""Mean slope across the edges, in grey values per sample, that counts as an edge."""
OUTERMOST = 1.5
"""End of the search in half sides; a corner is at 1.41."""
MAX_SPREAD_STEPS = 1.5
"""Robust deviation of the crossings from straight edges; noise alone has over 2."""
MIN_LEAD = 1.25
"""By how much the best roll must beat those that are far from it."""
MAX_TURN = math.radians(40.0)
"""An edge nearer than 5 degrees to halfway between two upper edges tells neither apart."""


class Roll(NamedTuple):
    """Where up is on the board."""

    up: Array  # (3,)
    """Unit vector along the board, camera frame: the target frame's z."""
    sigma_rad: float
    source: RollSource


def find_roll(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    board: CirclePose,
    target: Target,
    up_camera: Array | None,
) -> Roll:
    """From the board's edges, else from gravity, else from the camera's own up.

    Edges leave four answers a quarter turn apart; the one nearest to gravity (or to the camera's
    up) is taken.
    """
    hint = hinted_roll(board, up_camera)
    right = cross(hint.up, board.normal)
    turn = _edge_turn(image, intrinsics, board, target, (right, hint.up))
    if turn is None:
        return hint
    angle, sigma = turn
    up = math.cos(angle) * hint.up + math.sin(angle) * right
    sigma = math.hypot(sigma, EDGE_FLOOR_RAD)
    if hint.sigma_rad > ASSUMED_SIGMA_RAD:
        sigma = math.pi / 4  # sure of the edges, but not of which one is up
    return Roll(up, sigma, RollSource.EDGES)


def hinted_roll(board: CirclePose, up_camera: Array | None) -> Roll:
    """The roll of a board that hangs upright, or as upright as the camera is held."""
    if up_camera is not None and length(up_camera) > 1e-6:
        up = _along_board(board.normal, unit(up_camera))
        if up is not None:
            return Roll(up, GRAVITY_SIGMA_RAD, RollSource.GRAVITY)
    up = _along_board(board.normal, np.array([0.0, -1.0, 0.0]))
    if up is not None:
        return Roll(up, ASSUMED_SIGMA_RAD, RollSource.ASSUMED)
    # on a floor or a ceiling even the camera's up says nothing
    ahead = np.array([0.0, 0.0, 1.0])
    return Roll(unit(ahead - board.normal * board.normal[2]), UNKNOWN_SIGMA_RAD, RollSource.ASSUMED)


def rolled_pose(board: CirclePose, up: Array) -> Pose:
    """``camera_from_target`` of a board whose z axis is ``up`` laid onto it."""
    z = up - board.normal * float(up @ board.normal)
    z /= length(z)
    rotation = np.column_stack([board.normal, cross(z, board.normal), z])
    return Pose.from_rotation(rotation, board.center)


def _along_board(normal: Array, up: Array) -> Array | None:
    along = up - normal * float(normal @ up)
    sine = length(along)
    return np.asarray(along / sine) if sine >= MIN_UP_SINE else None


def _edge_turn(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    board: CirclePose,
    target: Target,
    axes: tuple[Array, Array],
) -> tuple[float, float] | None:
    """Turn [rad] from up towards right that lays the board's square on its edges, and its sigma.

    Rays from the centre cross a square's edge at half a side over the cosine of their angle to
    the side's normal. The turn whose four edges have the largest mean slopes is refined by a
    robust fit to the crossings near it.
    """
    half = target.board_side_m / 2
    px_per_m = math.sqrt(intrinsics.fx * intrinsics.fy) / length(board.center)
    if 2 * half * px_per_m < MIN_BOARD_PX:
        return None
    inner = 0.5 * (half + target.discs[0].diameter_m / 2)
    radii = np.linspace(inner, OUTERMOST * half, SAMPLES)
    right, up = axes
    rim = _COSINES[:, None] * up + _SINES[:, None] * right
    # through the lens at a few knots, linear in between: within a tenth of a pixel
    knots = np.linspace(inner, OUTERMOST * half, KNOTS)
    points = board.center + knots[None, :, None] * rim[:, None, :]
    uv = _BETWEEN_KNOTS @ project(points.reshape(-1, 3), intrinsics).reshape(RAYS, KNOTS, 2)
    height, width = image.shape
    last = (width - 1, height - 1)
    slope = slopes(gray_values(image, np.clip(uv, 0, last)))
    # a slope counts if its outermost sample is still in the picture; false for NaN, too
    inside = np.asarray(((uv >= 0) & (uv <= last)).all(axis=2))
    seen = inside[:, SAMPLES - slope.shape[1] :]
    slope = np.where(seen, slope, 0.0)
    first = (SAMPLES - slope.shape[1]) // 2
    step = float(radii[1] - radii[0])
    crossing = half * _STRETCH
    index = np.clip(np.rint((crossing - radii[0]) / step).astype(np.intp) - first, 0, None)
    index = np.minimum(index, slope.shape[1] - 1)
    across = slope[_ROWS, index]
    sides = (_ON_SIDE * across).sum(axis=2).T / (RAYS / 4)
    score = np.abs(sides).mean(axis=1)
    best = int(score.argmax())
    away = np.abs((_TURNS - _TURNS[best] + math.pi / 4) % (math.pi / 2) - math.pi / 4)
    rival = float(score[away > math.radians(12)].max())
    if score[best] < MIN_SLOPE or score[best] < MIN_LEAD * rival:
        return None
    return _refined(slope, best, sides[best], radii[first], step, half)


def _refined(
    slope: Array,
    best: int,
    sides: Array,
    first_radius: float,
    step: float,
    half: float,
) -> tuple[float, float] | None:
    """The turn [rad] fitted to the crossings near a candidate's edges, and its deviation."""
    off_normal = _OFF_NORMAL[best]
    crossing = half * _STRETCH[best]
    signs = np.sign(sides)[_SIDE_OF[best]]
    offset = np.arange(slope.shape[1]) * step + first_radius - crossing[:, None]
    window = np.where(np.abs(offset) < 5 * step, slope * signs[:, None], 0.0)
    edges = strongest_edges(window)
    reach = (edges.at - (SAMPLES - slope.shape[1]) // 2) * step + first_radius
    known = np.isfinite(reach)
    if np.count_nonzero(known) < RAYS / 3:
        return None
    # the distance of each crossing from its side's line, against turn and a common margin
    miss = reach[known] * np.cos(off_normal[known]) - half
    lever = reach[known] * np.sin(off_normal[known])  # miss = -turn * lever to first order
    design = np.stack([lever, np.ones_like(lever)], axis=1)
    fit = fit_robust(design, miss, np.zeros(2), 0.05 * step, iterations=5)
    if fit.sigma > MAX_SPREAD_STEPS * step or np.count_nonzero(fit.weights) < RAYS / 3:
        return None
    turn = float(_TURNS[best] - fit.coefficients[0])
    if abs(turn) > MAX_TURN:
        return None
    sigma = fit.sigma / math.sqrt(float(fit.weights @ np.square(lever)) + 1e-12)
    return turn, sigma


_ANGLES = np.arange(RAYS) * (2 * math.pi / RAYS)
_COSINES, _SINES = np.cos(_ANGLES), np.sin(_ANGLES)
_BETWEEN_KNOTS = np.maximum(
    1 - np.abs(np.linspace(0, KNOTS - 1, SAMPLES)[:, None] - np.arange(KNOTS)), 0.0
)
_TURNS = np.radians(np.arange(-45.0, 45.0, 2.5))
_ROWS = np.arange(RAYS)
# the angle of each ray to the normal of the side that it crosses, and that side, per turn
_FROM_TURN = (_ANGLES[None, :] - _TURNS[:, None] + math.pi / 4) % (2 * math.pi)
_SIDE_OF = np.minimum((_FROM_TURN / (math.pi / 2)).astype(np.intp), 3)
_OFF_NORMAL = _FROM_TURN - _SIDE_OF * (math.pi / 2) - math.pi / 4
_STRETCH = 1 / np.cos(_OFF_NORMAL)
_ON_SIDE = np.arange(4)[:, None, None] == _SIDE_OF
