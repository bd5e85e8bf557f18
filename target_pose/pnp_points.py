"""A target's labelled points as a net saw them: which can be used, and whether they are the target.

A net that looks for one class has nothing that nests. What tells a look-alike is that its points
are not where any pose of the target would put them: the error that is left is bounded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose.lens import rays_from_pixels
from target_pose.localisation import Refusal
from target_pose.pnp_fit import Measurements, PnpFit, fit_pose, predict_points
from target_pose.pnp_solve import MANY_POINTS, sampled_poses
from target_pose.points import MIN_BREADTH, MIN_POINTS, BoardPoint, PointPx, breadth
from target_pose.tukey import robust_sigma

Array: TypeAlias = NDArray[np.float64]

MIN_CONFIDENCE = 0.5
SIGMA_PX, SIGMA_SHARE = 1.0, 0.01
"""Standard deviation of a point's coordinate, to begin with: pixels, and over the target's size in
the picture; a net's regression errs with the size of what it looks at."""
GOOD = 3.0
"""Standard deviations within which no point is thought wrong."""
SIGMA_SAYS = 8
"""What that prior counts for, in measured coordinates."""
MAX_ERROR_PX, MAX_ERROR_SHARE, MAX_ERROR_CAP_PX = 3.0, 0.03, 12.0
"""Root mean square error of the points about the pose that fits them best, past which they are
another thing's: pixels, share of the target's size in the picture, and at most so many pixels."""
MIN_SHARE = 0.5
"""Of the points seen that must fit."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenPoints:
    """Points that can be used: confident, in the picture, with a ray."""

    yz_m: Array  # (N, 2)
    pixels: Array  # (N, 2)
    """Ideal: the principal point at zero, the lens undone."""
    focal: Array  # (2,) [px]

    @property
    def extent_px(self) -> float:
        """Longer side of the box around them."""
        return float(np.ptp(self.pixels, axis=0).max())


@dataclass(frozen=True, slots=True, eq=False)
class FittedPoints:
    """Points that are the target's, as sure as they turned out to be."""

    measured: Measurements
    """Those that fit alone."""
    poses: list[Pose]
    """Best first; the others are folds."""
    used: int


def seen_points(
    found: Mapping[str, PointPx],
    points: tuple[BoardPoint, ...],
    intrinsics: CameraIntrinsics,
    border_px: float,
) -> SeenPoints | Refusal:
    """The points that can be used, in the target's order.

    A net gives every point a place, also of what lies outside of the picture or is covered: at the
    border (``border_px``) and without confidence it only guesses.
    """
    kept = []
    for point in points:
        seen = found.get(point.name)
        if seen is not None and _usable(seen, intrinsics, border_px):
            kept.append((point.y_m, point.z_m, seen.u, seen.v))
    if len(kept) < MIN_POINTS:
        return Refusal.NO_EVIDENCE
    table = np.array(kept)
    rays = rays_from_pixels(table[:, 2:], intrinsics)
    real = np.isfinite(rays).all(axis=1)
    if np.count_nonzero(real) < MIN_POINTS:
        return Refusal.BAD_INTRINSICS
    focal = np.array([intrinsics.fx, intrinsics.fy])
    yz_m = table[real, :2]
    if breadth(yz_m) < MIN_BREADTH:
        return Refusal.NO_EVIDENCE
    return SeenPoints(yz_m, rays[real] * focal, focal)


def _usable(seen: PointPx, intrinsics: CameraIntrinsics, border_px: float) -> bool:
    inside = border_px <= seen.u <= intrinsics.width - 1 - border_px
    inside = inside and border_px <= seen.v <= intrinsics.height - 1 - border_px
    return inside and seen.confidence >= MIN_CONFIDENCE  # false for NaN, too


def fit_points(points: SeenPoints, min_extent_px: float) -> FittedPoints | Refusal:
    """The poses under which the points look so, if there is one.

    Their deviation is estimated from what is left over, together with a prior that carries weight
    where only a few are seen: four points leave two numbers over.
    """
    extent = points.extent_px
    if extent < min_extent_px:
        return Refusal.TOO_SMALL
    prior = math.hypot(SIGMA_PX, SIGMA_SHARE * extent)
    starts = sampled_poses(points.yz_m, points.pixels, points.focal, good_px=GOOD * prior)
    if not starts:
        return Refusal.BEHIND_CAMERA
    values = points.pixels.ravel()
    predict = predict_points(points.yz_m, points.focal)
    first = predict(starts[0].translation, starts[0].rotation, 0.0)
    if first is None:
        return Refusal.BEHIND_CAMERA
    limit = min(max(MAX_ERROR_PX, MAX_ERROR_SHARE * extent), MAX_ERROR_CAP_PX)
    sigma = min(robust_sigma(first.values - values, prior), max(limit, prior))
    measured = Measurements(values, np.eye(len(values)) / sigma**2, predict)
    many = len(points.yz_m) >= MANY_POINTS
    fits = [fit_pose(measured, start, robust=many) for start in starts]
    folds = sorted((fit for fit in fits if fit is not None), key=lambda fit: fit.cost)
    if not folds:
        return Refusal.BEHIND_CAMERA
    return _judged(points, folds, prior, limit)


def _judged(
    points: SeenPoints, folds: list[PnpFit], prior: float, limit: float
) -> FittedPoints | Refusal:
    """The points that fit the best fold, with the deviation that they show.

    Those that are left count in full: half weights would pass for half the deviation.
    """
    used = folds[0].weights[::2] > 0
    count = int(np.count_nonzero(used))
    if count < max(MIN_POINTS, MIN_SHARE * len(used)) or breadth(points.yz_m[used]) < MIN_BREADTH:
        return Refusal.POINTS_DISAGREE
    values = points.pixels[used].ravel()
    predict = predict_points(points.yz_m[used], points.focal)
    again = fit_pose(Measurements(values, np.eye(len(values)) / prior**2, predict), folds[0].pose)
    if again is None:
        return Refusal.BEHIND_CAMERA
    squares = float(again.errors @ again.errors)
    left_over = 2 * count - 6
    if math.sqrt(squares / left_over) > limit:
        return Refusal.POINTS_DISAGREE
    variance = (SIGMA_SAYS * prior**2 + squares) / (SIGMA_SAYS + left_over)
    measured = Measurements(values, np.eye(len(values)) / variance, predict)
    return FittedPoints(measured, [again.pose, *(fold.pose for fold in folds[1:])], count)
