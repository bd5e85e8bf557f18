"""The rough outline of the outer disc: where rays from the box's centre cross its edge."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from target_pose.profiles import blur_variance, gray_values, slopes, strongest_edges
from target_pose.tukey import RobustFit, fit_robust, solve_weighted

Array: TypeAlias = NDArray[np.float64]

RAYS = 60
NEAREST, FARTHEST = 0.35, 1.6
"""Part of each ray that is searched, in units of the guessed radius."""
FINEST_STEP_PX = 0.7
MAX_SAMPLES = 72
MIN_VALID_SHARE = 0.4
"""Of the rays that must cross an edge inside the picture: under it an arc says too little."""
MIN_INLIER_SHARE = 0.6
MAX_SPREAD = 0.045
"""Robust deviation of the crossings from an ellipse, in radii; noise alone has 0.2."""
GOOD_GUESS = 0.15
"""Error of a guess, in radii, from which no ray can mistake another circle for the outer one."""
MAX_SEARCHES = 3
MAX_GROWTH = 1.6
"""Of the disc over its guess; past it, it is another circle. A rolled board's box is 1.41 off."""
MIN_WIDTH_PX = 4.0
MIN_CONTRAST = 6.0
"""Grey values between disc and surroundings; JPEG's own steps are smaller."""


class DiscGuess(NamedTuple):
    """An upright ellipse where the outer disc may be."""

    center_px: tuple[float, float]
    semi_axes_px: tuple[float, float]


class Outline(NamedTuple):
    """A disc's outline, to about half a step of the search."""

    uv_px: Array  # (N, 2)
    blur_px: float
    """Standard deviation of its blur; NaN where the search was too coarse to see it."""


def find_disc(image: NDArray[np.uint8], guess: DiscGuess, dark_inside: bool) -> Outline | None:
    """The outline of the disc that the guess encloses roughly.

    Along each ray the steepest step of the right sign is taken; a robust fit of an ellipse sorts
    out the wrong ones. From a poor guess some rays reach another circle's edge: then the search is
    done again from the outline just found.

    Returns:
        The points that agree, or None where there is no such outline.
    """
    first = guess
    for _ in range(MAX_SEARCHES):
        found = _search(image, guess, dark_inside)
        if found is None:
            return None
        outline, better = found
        growth = math.sqrt(math.prod(better.semi_axes_px) / math.prod(first.semi_axes_px))
        if not 1 / MAX_GROWTH < growth < MAX_GROWTH:
            return None
        off = math.dist(guess.center_px, better.center_px) / min(guess.semi_axes_px)
        a, b = (n / o for n, o in zip(better.semi_axes_px, guess.semi_axes_px, strict=True))
        if max(off, abs(a - 1), abs(b - 1)) < GOOD_GUESS:
            break
        guess = better
    return outline


def _search(
    image: NDArray[np.uint8], guess: DiscGuess, dark_inside: bool
) -> tuple[Outline, DiscGuess] | None:
    """One search; the second value is the guess that it should have started from."""
    a, b = guess.semi_axes_px
    radius = math.sqrt(a * b)
    reach = FARTHEST - NEAREST
    samples = int(min(max(reach * radius / FINEST_STEP_PX, 20), MAX_SAMPLES))
    step = reach / (samples - 1)
    factors = NEAREST + step * np.arange(samples)
    arms = _UNIT * (a, b)
    uv = guess.center_px + arms[:, None, :] * factors[:, None]
    signed = slopes(gray_values(image, uv)) * (1.0 if dark_inside else -1.0)
    edges = strongest_edges(signed)
    known = np.isfinite(edges.at)
    if np.count_nonzero(known) < MIN_VALID_SHARE * RAYS:
        return None
    found = NEAREST + step * edges.at[known]
    floor = max(0.3 / radius, 0.01)
    fit = _fit_polar(found, _UNIT[known], floor)
    inliers = fit.weights > 0
    sharp = fit.sigma <= max(MAX_SPREAD, 0.8 / radius)
    many = np.count_nonzero(inliers) >= max(MIN_INLIER_SHARE * known.sum(), MIN_VALID_SHARE * RAYS)
    # the slope of a step of contrast k, blurred over two steps and smoothed: about k / 6 and more
    contrast = 6.0 * float(np.median(edges.slope[known]))
    rim = _rim(fit.coefficients)
    if not (sharp and many and contrast >= MIN_CONTRAST) or rim is None:
        return None
    curve = guess.center_px + arms * rim[:, None]
    (u0, v0), (u1, v1) = curve.min(axis=0).tolist(), curve.max(axis=0).tolist()
    if min(u1 - u0, v1 - v0) < MIN_WIDTH_PX:
        return None
    better = DiscGuess(((u0 + u1) / 2, (v0 + v1) / 2), ((u1 - u0) / 2, (v1 - v0) / 2))
    points = guess.center_px + arms[known][inliers] * found[inliers, None]
    return Outline(points, math.sqrt(blur_variance(signed, edges)) * step * radius), better


def _fit_polar(reach: Array, unit: Array, floor: float) -> RobustFit:
    """The conic A xx + B xy + C yy + D x + E y = 1 through points at ``reach`` (N,) along rays.

    Divided by the squared reach it is linear in its coefficients; the factor reach^3 / 2 turns its
    error into one of the reach, to first order.
    """
    x, y = unit.T
    scale = 0.5 * reach**3
    rows = np.stack([x * x, x * y, y * y, x / reach, y / reach], axis=1) * scale[:, None]
    values = 0.5 * reach
    typical = float(np.median(reach))
    start = np.array([1.0, 0.0, 1.0, 0.0, 0.0]) / typical**2
    # least absolute deviations first: the biweight alone would hold on to a poor start
    start = _least_absolute(rows, values, start, floor)
    return fit_robust(rows, values, start, floor, iterations=5)


def _rim(conic: Array) -> Array | None:
    """How far the conic of ``_fit_polar`` reaches along each of the rays (RAYS,); None if open."""
    x, y = _UNIT.T
    a, b, c, d, e = conic
    square = a * x * x + b * x * y + c * y * y
    line = d * x + e * y
    inside = line * line + 4 * square
    if not (inside > 0).all():
        return None
    inverse = 0.5 * (line + np.sqrt(inside))
    return np.asarray(1 / inverse) if (inverse > 1 / (2 * FARTHEST)).all() else None


def _least_absolute(design: Array, values: Array, start: Array, floor: float) -> Array:
    x = start
    for _ in range(4):
        weights = 1 / np.maximum(np.abs(values - design @ x), floor)
        x = solve_weighted(design, values, weights)
    return x


_THETA = np.arange(RAYS) * (2 * math.pi / RAYS)
_UNIT = np.stack([np.cos(_THETA), np.sin(_THETA)], axis=1)
