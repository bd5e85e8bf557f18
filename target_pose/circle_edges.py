"""Edge points of the printed circles, measured to a part of a pixel around a predicted pose."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from target_pose.conic import CirclePose
from target_pose.lens import project, rays_from_pixels
from target_pose.profiles import (
    SMOOTHING_STEPS,
    blur_variance,
    gray_values,
    slopes,
    strongest_edges,
)
from target_pose.target import Shade, Target
from target_pose.vectors import length, orthogonal_to

Array: TypeAlias = NDArray[np.float64]

MIN_CIRCLE_PX = 12.0
"""Least width of an inner circle that is measured: under it, its edges run into one another."""
CROSSTALK_FLOOR_PX = 0.02
"""Shift by a neighbouring edge that costs a point half of its say."""
MAX_POINTS = 64
"""Per circle."""
MIN_POINTS = 24
SAMPLES = 25
"""Per profile; the smoothing takes four at each end."""


class PrintedCircle(NamedTuple):
    """One edge of the print."""

    radius_m: float
    dark_inside: bool
    clearance_m: float
    """Distance to the next printed edge, be it a circle's or the board's."""


class CircleEdges(NamedTuple):
    """Measured points on the circles' edges, corrected for blur."""

    xy: Array  # (N, 2)
    """Rays through the points: x/z, y/z."""
    radius_m: Array  # (N,)
    """Of the circle that each one lies on."""
    dark_side: Array  # (N,)
    """Where the dark side lies: +1 inside, -1 outside."""
    share: Array  # (N,)
    """What one point counts for: less than 1 where neighbours share their pixels, next to nothing
    where another printed edge is so near that the two run into one another."""
    blur_px: float
    """Standard deviation of the blur; NaN if it could not be measured."""
    missing: float = 0.0
    """What the points would count for that lie in the picture, but where no edge was found."""


def printed_circles(target: Target) -> tuple[PrintedCircle, ...]:
    """The target's edges from the outside in."""
    radii = [target.board_side_m / 2, *(d.diameter_m / 2 for d in target.discs)]
    gaps = [outer - inner for outer, inner in pairwise(radii)]
    # inside the innermost disc there is no edge but its own
    clearances = [min(pair) for pair in zip(gaps, [*gaps[1:], math.inf], strict=True)]
    return tuple(
        PrintedCircle(disc.diameter_m / 2, disc.shade is Shade.BLACK, clearance)
        for disc, clearance in zip(target.discs, clearances, strict=True)
    )


def circles_worth_measuring(
    circles: tuple[PrintedCircle, ...], px_per_m: float
) -> tuple[PrintedCircle, ...]:
    """The outermost circle, and the inner ones that are wide enough."""
    inner = (c for c in circles[1:] if 2 * c.radius_m * px_per_m >= MIN_CIRCLE_PX)
    return (circles[0], *inner)


def measure_edges(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    pose: CirclePose,
    circles: tuple[PrintedCircle, ...],
    step_px: float,
) -> CircleEdges | None:
    """Look for every circle's edge within eight steps of where the pose predicts it.

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
    visible = np.isfinite(signed[:, 0])  # one value outside the picture makes all of them NaN
    edges = strongest_edges(signed)
    known = np.isfinite(edges.at) & np.isfinite(outline.curvature)
    if not known.any():
        return None
    blur2 = blur_variance(signed, edges) * step_px**2
    inward = 0.5 * outline.curvature[known] * (blur2 if math.isfinite(blur2) else 0.0)
    along = (edges.at[known] - (SAMPLES - 1) / 2) * step_px + inward
    edge_px = math.hypot(
        math.sqrt(blur2) if math.isfinite(blur2) else 1.0, SMOOTHING_STEPS * step_px
    )
    xy = rays_from_pixels(outline.uv[known] + outline.normal[known] * along[:, None], intrinsics)
    real = np.isfinite(xy).all(axis=1)
    if not real.any():
        return None
    share = _share(outline, edge_px)
    return CircleEdges(
        xy[real],
        outline.radius_m[known][real],
        outline.dark_side[known][real],
        share[known][real],
        math.sqrt(blur2) if math.isfinite(blur2) else math.nan,
        float(share[visible & ~known].sum()),
    )


def _share(outline: _Outline, edge_px: float) -> Array:
    """What the points count for, (N,).

    Of two opposite steps that a Gaussian of deviation s blurs, each moves the other's steepest
    point away by d exp(-(d/s)^2 / 2), d being their distance: to first order in the exponential.
    """
    d = outline.clearance_px
    shift = d * np.exp(-0.5 * np.square(d / edge_px))
    crowded = np.minimum(outline.spacing_px / 2.0, 1.0)
    # a shift is alike in neighbouring points, so that their number does not average it out
    return np.asarray(crowded / (1 + np.square(shift / CROSSTALK_FLOOR_PX)))


class _Outline(NamedTuple):
    uv: Array  # (N, 2)
    normal: Array  # (N, 2), outwards
    curvature: Array  # (N,) [1/px]
    spacing_px: Array  # (N,)
    clearance_px: Array  # (N,)
    radius_m: Array  # (N,)
    dark_side: Array  # (N,)


def _outline(
    intrinsics: CameraIntrinsics, pose: CirclePose, circles: tuple[PrintedCircle, ...]
) -> _Outline:
    """The circles as the pose predicts them in the picture, with normals and curvatures."""
    right, up = orthogonal_to(pose.normal)
    px_per_m = math.sqrt(intrinsics.fx * intrinsics.fy) / length(pose.center)
    radius_m = np.array([circle.radius_m for circle in circles])
    around = 2 * math.pi * float(radius_m.max()) * px_per_m
    count = int(min(max(around, MIN_POINTS), MAX_POINTS))
    angle = np.arange(count) * (2 * math.pi / count)
    rim = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up
    points = pose.center + radius_m[:, None, None] * rim
    pixels = project(np.concatenate([pose.center[None], points.reshape(-1, 3)]), intrinsics)
    center, uv = pixels[0], pixels[1:].reshape(len(circles), count, 2)
    # derivatives around the closed curves by central differences: exact for ellipses
    h = 2 * math.pi / count
    ahead, behind = np.roll(uv, -1, axis=1), np.roll(uv, 1, axis=1)
    first = (ahead - behind) / (2 * math.sin(h))
    second = (ahead - 2 * uv + behind) / (2 - 2 * math.cos(h))
    speed = np.maximum(np.hypot(first[..., 0], first[..., 1]), 1e-9)
    turn = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    outwards = np.sign(turn) / speed
    normal = np.stack([first[..., 1] * outwards, -first[..., 0] * outwards], axis=-1)
    # how many pixels a metre has across the edge, but for perspective within the disc
    px_per_m_across = ((uv - center) * normal).sum(axis=-1) / radius_m[:, None]
    clearance_m = np.array([min(c.clearance_m, 2 * c.radius_m) for c in circles])
    dark_side = np.array([1.0 if circle.dark_inside else -1.0 for circle in circles])
    return _Outline(
        uv=uv.reshape(-1, 2),
        normal=normal.reshape(-1, 2),
        curvature=(np.abs(turn) / speed**3).ravel(),
        spacing_px=(speed * h).ravel(),
        clearance_px=(px_per_m_across * clearance_m[:, None]).ravel(),
        radius_m=np.repeat(radius_m, count),
        dark_side=np.repeat(dark_side, count),
    )
