"""From a box to the printed circles: found, measured, and fitted in both folds."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from target_pose.box_guess import BoxGuess
from target_pose.circle_edges import (
    CircleEdges,
    PrintedCircle,
    circles_worth_measuring,
    measure_edges,
)
from target_pose.conic import CirclePose, circle_poses
from target_pose.disc_finder import find_disc
from target_pose.ellipse import fit_ellipse
from target_pose.fusion import CircleFit, fit_circles
from target_pose.lens import rays_from_pixels
from target_pose.plane import InverseDepthPlane
from target_pose.vectors import length

Array: TypeAlias = NDArray[np.float64]

MIN_STEP_PX, MAX_STEP_PX = 0.4, 2.0
STEP_PER_BLUR = 0.45
"""Step of the profiles over the blur: eight steps each way hold the whole edge."""
MIN_INLIER_SHARE = 0.5
"""Of the edge points measured; the rest may be covered."""
MIN_POINTS = 16
MAX_RMS_PX = 0.6
MAX_RMS_SHARE = 0.01
"""Root mean square error over the disc's radius past which the outline is no circle's."""


class RoughCircle(NamedTuple):
    """The outer disc before its pose is refined."""

    folds: tuple[CirclePose, CirclePose]
    step_px: float
    """Profile step that fits the picture's blur."""


class SeenCircles(NamedTuple):
    """The circles' edges, and the two poses from which the outer one looks the same."""

    edges: CircleEdges
    folds: tuple[CirclePose, CirclePose]
    """Of the outer circle alone; the one nearer to a normal known from elsewhere first."""
    radius_px: float
    """Of the outer circle."""


def find_circle(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    outer: PrintedCircle,
    guesses: list[BoxGuess],
) -> RoughCircle | None:
    """Find the outer disc by the first guess under which it shows."""
    for guess in guesses:
        outline = find_disc(image, guess.disc, outer.dark_inside)
        if outline is None:
            continue
        folds = _poses(rays_from_pixels(outline.uv_px, intrinsics), outer.radius_m)
        if folds is None:
            continue
        blur = outline.blur_px if math.isfinite(outline.blur_px) else 1.0
        return RoughCircle(folds, min(max(STEP_PER_BLUR * blur, MIN_STEP_PX), MAX_STEP_PX))
    return None


def measure_circles(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    circles: tuple[PrintedCircle, ...],
    rough: RoughCircle,
    nearest_to: Array | None,
) -> SeenCircles | None:
    """Measure all circles that are large enough.

    ``nearest_to`` (3,) is a normal from elsewhere: the fold nearer to it predicts where the inner
    circles lie.
    """
    first, second = rough.folds
    if nearest_to is not None and second.normal @ nearest_to > first.normal @ nearest_to:
        first, second = second, first
    px_per_m = _px_per_m(intrinsics, first)
    worth = circles_worth_measuring(circles, px_per_m)
    edges = measure_edges(image, intrinsics, first, worth, rough.step_px)
    if edges is None or len(edges.xy) < MIN_POINTS:
        return None
    return SeenCircles(edges, (first, second), circles[0].radius_m * px_per_m)


def fit_fold(
    seen: SeenCircles,
    intrinsics: CameraIntrinsics,
    start: CirclePose,
    plane: InverseDepthPlane | None = None,
) -> CircleFit | None:
    """The pose near a start that fits the edges (and the plane); None if they are no circles."""
    fit = fit_circles(seen.edges, intrinsics, start, plane)
    return fit if fit is not None and _round(fit, seen.radius_px) else None


def _poses(xy: Array, radius_m: float) -> tuple[CirclePose, CirclePose] | None:
    real = np.isfinite(xy).all(axis=1)
    conic = fit_ellipse(xy[real])
    return None if conic is None else circle_poses(conic, radius_m)


def _px_per_m(intrinsics: CameraIntrinsics, pose: CirclePose) -> float:
    return math.sqrt(intrinsics.fx * intrinsics.fy) / length(pose.center)


def _round(fit: CircleFit, radius_px: float) -> bool:
    """The edge points lie on the circles of one pose."""
    many = np.count_nonzero(fit.inliers) >= max(MIN_POINTS, MIN_INLIER_SHARE * len(fit.inliers))
    return bool(many) and fit.rms_px <= max(MAX_RMS_PX, MAX_RMS_SHARE * radius_px)
