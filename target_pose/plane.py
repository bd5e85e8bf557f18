"""A plane through depth points, fitted in inverse depth with outliers and correlated noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from target_pose.tukey import fit_robust, robust_sigma, solve_weighted
from target_pose.vectors import length, unit

Array: TypeAlias = NDArray[np.float64]

MIN_POINTS = 30
MIN_INLIER_SHARE = 0.4
"""Of the depth points on the board that must lie on one plane."""
SCALE_SIGMA = 5e-3
"""Relative error of a stereo camera's depth scale, alike in all points of a frame."""
TILT_SIGMA_RAD = 1e-2
"""Warp of the depth image across a target, alike in all points of a frame: 0.6 degrees. On a real
recording of a structured-light camera the plane's normal was 0.9 degrees off in the median."""
NOISE_FLOOR = 2e-4
"""Least standard deviation of inverse depth [1/m] believed; a step of 1 mm at 1.5 m has 1.3e-4."""
TRIPLES = 24
CELLS = 6
"""Cells per side in which the residuals' correlation is measured."""
CELL_BORDER_LOSS = 1.4
"""What correlation across the cells' borders adds."""


@dataclass(frozen=True, slots=True, eq=False)
class InverseDepthPlane:
    """The plane 1/z = a x/z + b y/z + c in the camera frame.

    A stereo camera measures disparity, which is inverse depth but for a factor: there its noise is
    alike everywhere and the plane is linear, so that least squares is not biased.
    """

    coefficients: Array  # (3,) [1/m]
    """a, b, c: the plane's normal over its signed distance, n / (n . p) for any p on it."""
    information: Array  # (3, 3)
    """Inverse covariance of the coefficients, with the depth's errors of scale and warp."""
    inliers: int
    sigma: float
    """Robust standard deviation of the points' inverse depths [1/m]."""

    @property
    def normal(self) -> Array:
        """Unit normal (3,) towards the camera."""
        return np.asarray(-unit(self.coefficients))

    def depth_along(self, ray: Array) -> float:
        """Depth z [m] at which a ray (3,) with z = 1 meets the plane; infinite if it never does."""
        inverse = float(self.coefficients @ ray)
        return 1 / inverse if inverse > 1e-9 else math.inf

    def range_along(self, center: Array) -> float:
        """Distance [m] to the plane along the bearing of a point (3,)."""
        ray = center / center[2]
        return self.depth_along(ray) * length(ray)


@dataclass(frozen=True, slots=True, eq=False)
class BoardPlane:
    """The board's plane in the depth."""

    plane: InverseDepthPlane
    rms_m: float
    """Robust deviation of the points from it along the camera's axis."""


def board_plane(points: Array) -> BoardPlane | None:
    """The plane of the points (N, 3) on a board; None if ``fit_plane`` finds none."""
    plane = fit_plane(points)
    return None if plane is None else BoardPlane(plane, plane_scatter(plane, points))


def fit_plane(points: Array) -> InverseDepthPlane | None:
    """The plane that most of the points (N, 3) in the camera frame lie on.

    Least median of squares over fixed triples finds it whatever the outliers (P. Rousseeuw, 1984),
    Tukey's biweight refines it. The covariance is the sandwich over cells of the picture, since
    neighbouring depths of a stereo camera err together.

    Returns:
        The plane, or None with too few points, or without a plane that faces the camera and that
        enough of them agree on.
    """
    if len(points) < MIN_POINTS:
        return None
    inverse = 1 / points[:, 2]
    design = np.column_stack([points[:, :2] * inverse[:, None], np.ones(len(points))])
    mean = design[:, :2].mean(axis=0)
    centred = design - (*mean, 0.0)
    spread = float(np.sqrt(np.square(centred[:, :2]).sum(axis=1).mean()))
    if spread < 1e-6:
        return None
    centred[:, :2] /= spread
    start = _least_median(centred, inverse)
    fit = fit_robust(centred, inverse, start, NOISE_FLOOR)
    inliers = int(np.count_nonzero(fit.weights))
    if inliers < max(MIN_POINTS, MIN_INLIER_SHARE * len(points)):
        return None
    covariance = _covariance(centred, inverse - centred @ fit.coefficients, fit.weights, fit.sigma)
    restore = np.array(
        [[1 / spread, 0, 0], [0, 1 / spread, 0], [-mean[0] / spread, -mean[1] / spread, 1.0]]
    )
    coefficients = restore @ fit.coefficients
    center = np.array([*mean, 1.0])
    if coefficients @ center <= 1e-6:
        return None
    covariance = restore @ covariance @ restore.T
    covariance += _systematic(coefficients, center)
    information = np.linalg.inv(covariance)
    return InverseDepthPlane(coefficients, 0.5 * (information + information.T), inliers, fit.sigma)


def _systematic(coefficients: Array, center: Array) -> Array:
    """Covariance (3, 3) of an error of scale, and of a tilt about the points' centre."""
    ray = unit(center)
    across = np.eye(3) - np.outer(ray, ray)
    scale = SCALE_SIGMA**2 * np.outer(coefficients, coefficients)
    return np.asarray(scale + (TILT_SIGMA_RAD * length(coefficients)) ** 2 * across)


def _least_median(design: Array, values: Array) -> Array:
    """Coefficients (3,) through three points that leave the least median error.

    The triples are fixed, so that the same frame always gives the same answer.
    """
    count = len(values)
    picks = (_FRACTIONS * count).astype(np.intp)
    systems = design[picks]
    sound = np.abs(np.linalg.det(systems)) > 1e-3
    candidates = solve_weighted(design, values, np.ones(count))[None]
    if sound.any():
        solved = np.linalg.solve(systems[sound], values[picks[sound]][..., None])[..., 0]
        candidates = np.concatenate([candidates, solved])
    some = slice(None, None, max(count // 200, 1))
    errors = np.abs(values[some, None] - design[some] @ candidates.T)
    middle = len(errors) // 2
    return np.asarray(candidates[int(np.partition(errors, middle, axis=0)[middle].argmin())])


def _covariance(design: Array, residuals: Array, weights: Array, sigma: float) -> Array:
    """Of the coefficients (3, 3), with the errors' correlation measured from their sums over cells.

    Were the errors independent, the squared sums over cells would add up to the squared errors;
    the ratio is the number of points that err as one.
    """
    bread = np.asarray(np.linalg.inv((design.T * weights) @ design + 1e-12 * np.eye(3)))
    span = np.ptp(design[:, :2], axis=0) + 1e-12
    cell = ((design[:, :2] - design[:, :2].min(axis=0)) / span * (CELLS - 1e-6)).astype(np.intp)
    errors = weights * residuals
    sums = np.bincount(cell[:, 0] * CELLS + cell[:, 1], errors, minlength=CELLS * CELLS)
    alike = float(sums @ sums) / max(float(errors @ errors), 1e-300)
    return np.asarray(sigma**2 * max(CELL_BORDER_LOSS * alike, 1.0) * bread)


def plane_scatter(plane: InverseDepthPlane, points: Array) -> float:
    """Robust deviation [m] of points (N, 3) from the plane along the camera's axis."""
    inverse = 1 / points[:, 2]
    design = np.column_stack([points[:, :2] * inverse[:, None], np.ones(len(points))])
    errors = inverse - design @ plane.coefficients
    return robust_sigma(errors * np.square(points[:, 2]), 0.0)


_FRACTIONS = np.random.default_rng(0).random((TRIPLES, 3))
