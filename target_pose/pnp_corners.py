"""The board's four corners to a part of a pixel: its edges as straight lines, crossed."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose.fusion import DARK_SHIFT_SIGMA_PX, EDGE_FLOOR_PX
from target_pose.lens import project, rays_from_pixels
from target_pose.profiles import gray_values, slopes, strongest_edges
from target_pose.target import Target
from target_pose.tukey import fit_robust
from target_pose.vectors import length

Array: TypeAlias = NDArray[np.float64]

PROFILES = 32
"""Per side, and at most one a pixel."""
MIN_PROFILES = 8
ENDS = 0.08
"""Part of a side at each end where the next side's blur reaches in."""
SAMPLES = 25
"""Per profile; the smoothing takes four at each end."""
REACH = 0.6
"""Part of the margin between disc and edge that a profile goes inwards, and as far outwards."""
MIN_STEP_PX, MAX_STEP_PX = 0.25, 1.5
MIN_SLOPE = 1.0
"""Mean slope across a side, in grey values per step, that counts as an edge."""
MIN_SHARE = 0.5
"""Of the profiles of a side that must agree on a line."""
MAX_SPREAD_PX = 0.6
LINE_FLOOR_PX = 0.03
"""Error of a line at its ends that no number of profiles averages out: an edge along the raster
lies in the same phase of pixels and of a JPEG's blocks all the way."""
SHARED_PX = 3.0
"""Profiles nearer to one another than this err alike: they share pixels, and blocks of a JPEG."""


class Corners(NamedTuple):
    """The board's corners, in the order of ``corner_places``."""

    pixels: Array  # (4, 2)
    """Ideal: the principal point at zero, the lens undone."""
    covariance: Array  # (8, 8) [px^2]
    """Of u, v, u, v, ...: neighbours share a side, and one tone curve moves all sides."""
    profiles: int
    """Edge points used."""


def corner_places(side_m: float) -> Array:
    """Places (4, 2) as y and z of the corners, side k from corner k to k + 1."""
    half = side_m / 2
    return half * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def measure_corners(
    image: NDArray[np.uint8], intrinsics: CameraIntrinsics, pose: Pose, target: Target
) -> Corners | None:
    """Look for the four edges where a pose predicts them, within half of the board's margin.

    Corners themselves are measured worst of all: they are blurred in two directions and lie on
    whatever hangs behind. The edges are long, and four lines have as many numbers as four corners.

    Returns:
        The corners, or None where one of the sides is not seen.
    """
    sides = _sides(intrinsics, pose, target)
    if sides is None:
        return None
    offsets = sides.step_px[:, None] * (np.arange(SAMPLES) - (SAMPLES - 1) / 2)
    uv = sides.uv[:, :, None] + sides.outward[:, :, None] * offsets[:, None, :, None]
    slope = slopes(gray_values(image, uv).reshape(-1, SAMPLES)).reshape(4, len(sides.along), -1)
    focal = np.array([intrinsics.fx, intrinsics.fy])
    lines = []
    for k in range(4):
        line = _line(sides, k, slope[k], intrinsics, focal)
        if line is None:
            return None
        lines.append(line)
    return _crossed(lines)


class _Sides(NamedTuple):
    """The board's edges as a pose predicts them."""

    along: Array  # (N,) part of the way from one corner to the next
    uv: Array  # (4, N, 2)
    outward: Array  # (4, N, 2) unit vectors across the edges
    step_px: Array  # (4,)
    ends: Array  # (4, 2) ideal pixels of the corners


class _Line(NamedTuple):
    """(normal - slope direction) . (x - origin) = offset, in ideal pixels."""

    origin: Array  # (2,)
    direction: Array  # (2,)
    normal: Array  # (2,) outwards
    offset: float
    slope: float
    covariance: Array  # (2, 2) of offset and slope
    dark_outside: float
    """1 or -1."""
    points: int


def _sides(intrinsics: CameraIntrinsics, pose: Pose, target: Target) -> _Sides | None:
    places = corner_places(target.board_side_m)
    corners = pose @ np.column_stack([np.zeros(4), places])
    if not corners[:, 2].min() > 0:
        return None
    middle = project(pose.translation[None], intrinsics)[0]
    seen = project(corners, intrinsics)
    if not np.isfinite(seen).all() or not np.isfinite(middle).all():
        return None
    chords = np.roll(seen, -1, axis=0) - seen
    shortest = float(np.hypot(*chords.T).min())
    count = min(PROFILES, int(shortest * (1 - 2 * ENDS)))
    if count < MIN_PROFILES:
        return None
    along = np.linspace(ENDS, 1 - ENDS, count)
    points = corners[:, None] + along[:, None] * (np.roll(corners, -1, axis=0) - corners)[:, None]
    uv = project(points.reshape(-1, 3), intrinsics).reshape(4, count, 2)
    if not np.isfinite(uv).all():
        return None
    tangent = np.asarray(np.gradient(uv, axis=1))
    outward = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    outward *= np.sign(((uv - middle) * outward).sum(axis=-1, keepdims=True))
    across_px = ((uv - middle) * outward).sum(axis=-1).min(axis=1)
    margin = 1 - target.discs[0].diameter_m / target.board_side_m
    step_px = np.clip(REACH * margin * across_px / 8, MIN_STEP_PX, MAX_STEP_PX)
    focal = np.array([intrinsics.fx, intrinsics.fy])
    return _Sides(along, uv, outward, step_px, corners[:, :2] / corners[:, 2:] * focal)


def _line(
    sides: _Sides, k: int, slope: Array, intrinsics: CameraIntrinsics, focal: Array
) -> _Line | None:
    """A line through the edge points of one side."""
    known = np.isfinite(slope).all(axis=1)
    if np.count_nonzero(known) < MIN_PROFILES:
        return None
    # the wall may be darker than the board or lighter
    falls, rises = (float((sign * slope[known]).max(axis=1).mean()) for sign in (-1, 1))
    if max(falls, rises) < MIN_SLOPE:
        return None
    dark_outside = 1.0 if falls > rises else -1.0
    edges = strongest_edges(-dark_outside * slope)
    known = np.isfinite(edges.at)
    reach = (edges.at[known] - (SAMPLES - 1) / 2) * sides.step_px[k]
    seen = sides.uv[k][known] + sides.outward[k][known] * reach[:, None]
    ideal = rays_from_pixels(seen, intrinsics) * focal
    ideal = ideal[np.isfinite(ideal).all(axis=1)]
    needed = max(MIN_PROFILES, MIN_SHARE * len(sides.along))
    if len(ideal) < needed:
        return None
    start, end = sides.ends[k], sides.ends[(k + 1) % 4]
    origin, chord = (start + end) / 2, end - start
    direction = chord / length(chord)
    normal = np.array([direction[1], -direction[0]])
    normal *= -np.sign(normal @ (sides.ends.mean(axis=0) - origin))
    way, off = (ideal - origin) @ direction, (ideal - origin) @ normal
    design = np.column_stack([np.ones_like(way), way])
    fit = fit_robust(design, off, np.array([float(np.median(off)), 0.0]), EDGE_FLOOR_PX)
    used = int(np.count_nonzero(fit.weights))
    if used < needed or fit.sigma > MAX_SPREAD_PX:
        return None
    spacing = length(chord) * (1 - 2 * ENDS) / (len(sides.along) - 1)
    alike = max(SHARED_PX / spacing, 1.0)
    spread = np.linalg.inv((design.T * fit.weights) @ design) * fit.sigma**2 * alike
    spread += np.diag([1.0, 4 / length(chord) ** 2]) * LINE_FLOOR_PX**2
    offset, lean = (float(c) for c in fit.coefficients)
    return _Line(origin, direction, normal, offset, lean, spread, dark_outside, used)


def _crossed(lines: list[_Line]) -> Corners | None:
    """Corner k lies where sides k - 1 and k cross."""
    pixels, by_lines = np.empty((4, 2)), np.zeros((8, 8))
    for k in range(4):
        pair = (lines[k - 1], lines[k])
        facing = np.array([line.normal - line.slope * line.direction for line in pair])
        if abs(float(np.linalg.det(facing))) < 1e-3:
            return None
        beyond = [row @ line.origin + line.offset for row, line in zip(facing, pair, strict=True)]
        pixels[k] = np.linalg.solve(facing, beyond)
        moved = np.linalg.inv(facing)
        for column, (line, side) in enumerate(zip(pair, ((k - 1) % 4, k), strict=True)):
            way = float((pixels[k] - line.origin) @ line.direction)
            by_lines[2 * k : 2 * k + 2, 2 * side] = moved[:, column]
            by_lines[2 * k : 2 * k + 2, 2 * side + 1] = moved[:, column] * way
    covariance = np.zeros((8, 8))
    for k, line in enumerate(lines):
        covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = line.covariance
    # tone curve, glare and ink move every edge towards its dark side alike
    shift = np.zeros(8)
    shift[::2] = [DARK_SHIFT_SIGMA_PX * line.dark_outside for line in lines]
    covariance += np.outer(shift, shift)
    if not np.isfinite(pixels).all():
        return None
    points = sum(line.points for line in lines)
    return Corners(pixels, by_lines @ covariance @ by_lines.T, points)
