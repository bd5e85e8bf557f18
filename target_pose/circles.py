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
from target_pose.fusion import OUTLIER_COST, CircleFit, fit_circles
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


class SeenFold(NamedTuple):
    """The circles' edges where one fold predicts them, and the pose there that fits them best."""

    edges: CircleEdges
    fit: CircleFit
    radius_px: float
    """Of the outer circle."""

    def cost(self, sigma_px: float) -> float:
        """Squared errors in standard deviations; an edge that is not there counts as an outlier."""
        return self.fit.cost(sigma_px) + OUTLIER_COST * self.edges.missing


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


def fit_fold(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    circles: tuple[PrintedCircle, ...],
    rough: RoughCircle,
    fold: CirclePose,
) -> SeenFold | None:
    """Measure all circles that are large enough, near one of the rough folds, and fit the pose.

    Near the target the folds predict the inner circles in different places, so that each has to
    look for its own.

    Returns:
        The fit, or None if what is there is not circles.
    """
    px_per_m = _px_per_m(intrinsics, rough.folds[0])
    worth = circles_worth_measuring(circles, px_per_m)
    edges = measure_edges(image, intrinsics, fold, worth, rough.step_px)
    if edges is None or len(edges.xy) < MIN_POINTS:
        return None
    radius_px = circles[0].radius_m * px_per_m
    fit = fit_circles(edges, intrinsics, fold)
    return SeenFold(edges, fit, radius_px) if fit is not None and _round(fit, radius_px) else None


def fit_with_plane(
    seen: SeenFold, intrinsics: CameraIntrinsics, plane: InverseDepthPlane
) -> CircleFit | None:
    """The pose that fits edges and plane together; None if it does not fit the edges any more."""
    fit = fit_circles(seen.edges, intrinsics, seen.fit.pose, plane)
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
