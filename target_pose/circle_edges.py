"""Edge points of the printed circles, measured to a part of a pixel around a predicted pose."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from target_pose.conic import CirclePose
from target_pose.lens import project, rays_from_pixels
from target_pose.profiles import blur_variance, gray_values, slopes, strongest_edges
from target_pose.target import Shade, Target

Array: TypeAlias = NDArray[np.float64]

MIN_CIRCLE_PX = 12.0
"""Least width of an inner circle that is measured: under it, its edges run into one another."""
MIN_GAP_PX = 3.0
"""Least distance between two printed edges that are measured, for the same reason."""
MAX_POINTS = 80
"""Per circle."""
MIN_POINTS = 24
SAMPLES = 21
"""Per profile; the smoothing takes four at each end."""


class PrintedCircle(NamedTuple):
    """One edge of the print."""

    radius_m: float
    dark_inside: bool


class CircleEdges(NamedTuple):
    """Measured points on the circles' edges, corrected for blur."""

    xy: Array  # (N, 2)
    """Rays through the points: x/z, y/z."""
    radius_m: Array  # (N,)
    """Of the circle that each one lies on."""
    dark_side: Array  # (N,)
    """Where the dark side lies: +1 inside, -1 outside."""
    share: Array  # (N,)
    """What one point counts for: less than 1 where neighbours share their pixels."""
    blur_px: float
    """Standard deviation of the blur; NaN if it could not be measured."""


def printed_circles(target: Target) -> tuple[PrintedCircle, ...]:
    """The target's edges from the outside in."""
    return tuple(PrintedCircle(d.diameter_m / 2, d.shade is Shade.BLACK) for d in target.discs)


def circles_worth_measuring(
    circles: tuple[PrintedCircle, ...], px_per_m: float, foreshortening: float
) -> tuple[PrintedCircle, ...]:
    """The outermost circle, and the inner ones that are wide enough and stand clear."""
    kept = [circles[0]]
    radii = [c.radius_m for c in circles] + [0.0]
    for k in range(1, len(circles)):
        narrow_px = px_per_m * foreshortening
        gap_m = min(radii[k - 1] - radii[k], 2 * radii[k] if k == len(circles) - 1 else math.inf)
        if k < len(circles) - 1:
            gap_m = min(gap_m, radii[k] - radii[k + 1])
        if 2 * radii[k] * px_per_m >= MIN_CIRCLE_PX and gap_m * narrow_px >= MIN_GAP_PX:
            kept.append(circles[k])
    return tuple(kept)


def measure_edges(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    pose: CirclePose,
    circles: tuple[PrintedCircle, ...],
    step_px: float,
) -> CircleEdges | None:
    """Look for every circle's edge within about 6 steps of where the pose predicts it.

    A disc's edge that is blurred by a Gaussian of variance s^2 moves inwards by s^2 k / 2, with k
    the curvature of its outline in the picture: the variance is measured from the profiles
    themselves and the shift is taken out (docs/localisation.md).

    Returns:
        The points, or None if the circles do not lie in the picture.
    """
    outline = _outline(intrinsics, pose, circles)
    offsets = step_px * (np.arange(SAMPLES) - (SAMPLES - 1) / 2)
    uv = outline.uv[:, None, :] + outline.normal[:, None, :] * offsets[:, None]
    signed = slopes(gray_values(image, uv)) * outline.dark_side[:, None]
    edges = strongest_edges(signed)
    known = np.isfinite(edges.at) & np.isfinite(outline.curvature)
    if not known.any():
        return None
    blur2 = blur_variance(signed, edges) * step_px**2
    inward = 0.5 * outline.curvature[known] * (blur2 if math.isfinite(blur2) else 0.0)
    along = (edges.at[known] - (SAMPLES - 1) / 2) * step_px + inward
    xy = rays_from_pixels(outline.uv[known] + outline.normal[known] * along[:, None], intrinsics)
    real = np.isfinite(xy).all(axis=1)
    if not real.any():
        return None
    return CircleEdges(
        xy[real],
        outline.radius_m[known][real],
        outline.dark_side[known][real],
        np.minimum(outline.spacing_px[known][real] / 2.0, 1.0),
        math.sqrt(blur2) if math.isfinite(blur2) else math.nan,
    )


class _Outline(NamedTuple):
    uv: Array  # (N, 2)
    normal: Array  # (N, 2), outwards
    curvature: Array  # (N,) [1/px]
    spacing_px: Array  # (N,)
    radius_m: Array  # (N,)
    dark_side: Array  # (N,)


def _outline(
    intrinsics: CameraIntrinsics, pose: CirclePose, circles: tuple[PrintedCircle, ...]
) -> _Outline:
    """The circles as the pose predicts them in the picture, with normals and curvatures."""
    right, up = board_axes(pose.normal)
    px_per_m = math.sqrt(intrinsics.fx * intrinsics.fy) / float(np.linalg.norm(pose.center))
    parts = []
    for circle in circles:
        around = 2 * math.pi * circle.radius_m * px_per_m
        count = int(min(max(around, MIN_POINTS), MAX_POINTS))
        angle = np.arange(count) * (2 * math.pi / count)
        rim = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up
        uv = project(pose.center + circle.radius_m * rim, intrinsics)
        # derivatives around the closed curve by central differences: exact enough at 24 points
        h = 2 * math.pi / count
        ahead, behind = np.roll(uv, -1, axis=0), np.roll(uv, 1, axis=0)
        first = (ahead - behind) / (2 * math.sin(h))
        second = (ahead - 2 * uv + behind) / (2 - 2 * math.cos(h))
        speed = np.hypot(first[:, 0], first[:, 1])
        turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        normal = np.stack([first[:, 1], -first[:, 0]], axis=1) / np.maximum(speed, 1e-9)[:, None]
        normal *= np.sign(turn)[:, None]
        parts.append(
            (
                uv,
                normal,
                np.abs(turn) / np.maximum(speed, 1e-9) ** 3,
                speed * h,
                np.full(count, circle.radius_m),
                np.full(count, 1.0 if circle.dark_inside else -1.0),
            )
        )
    return _Outline(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def board_axes(normal: Array) -> tuple[Array, Array]:
    """Two unit vectors that span the board's plane; any two, the roll being unknown here."""
    least = np.zeros(3)
    least[int(np.abs(normal).argmin())] = 1.0
    right = np.cross(normal, least)
    right /= np.linalg.norm(right)
    return right, np.cross(normal, right)
