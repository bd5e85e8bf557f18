"""The rough outline of the outer disc: where rays from the box's centre cross its edge."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from target_pose.profiles import gray_values, slopes, strongest_edges
from target_pose.tukey import fit_robust

Array: TypeAlias = NDArray[np.float64]

RAYS = 72
NEAREST, FARTHEST = 0.5, 1.45
"""Part of each ray that is searched, in units of the guessed radius."""
FINEST_STEP_PX = 0.5
MAX_SAMPLES = 72
MIN_VALID_SHARE = 0.4
"""Of the rays that must cross an edge inside the picture: under it an arc says too little."""
MIN_INLIER_SHARE = 0.6
MAX_SPREAD = 0.045
"""Robust deviation of the crossings from an ellipse, in radii; noise alone has 0.2."""
MIN_CONTRAST = 6.0
"""Grey values between disc and surroundings; JPEG's own steps are smaller."""


class DiscGuess(NamedTuple):
    """An upright ellipse where the outer disc may be."""

    center_px: tuple[float, float]
    semi_axes_px: tuple[float, float]


def find_disc(image: NDArray[np.uint8], guess: DiscGuess, dark_inside: bool) -> Array | None:
    """Points (N, 2) [px] on the outline of the disc that the guess encloses roughly.

    Along each ray the steepest step of the right sign is taken; a robust fit of the second-order
    harmonics, which are what an ellipse near the guess adds to it, sorts out the wrong ones.

    Returns:
        The points that agree, or None where there is no such outline.
    """
    a, b = guess.semi_axes_px
    radius = math.sqrt(a * b)
    reach = FARTHEST - NEAREST
    samples = int(min(max(reach * radius / FINEST_STEP_PX, 20), MAX_SAMPLES))
    factors = NEAREST + reach * np.arange(samples) / (samples - 1)
    step = reach / (samples - 1)
    arms = _UNIT * (a, b)
    uv = guess.center_px + arms[:, None, :] * factors[:, None]
    signed = slopes(gray_values(image, uv)) * (1.0 if dark_inside else -1.0)
    edges = strongest_edges(signed)
    known = np.isfinite(edges.at)
    if np.count_nonzero(known) < MIN_VALID_SHARE * RAYS:
        return None
    found = NEAREST + step * edges.at[known]
    start = np.zeros(5)
    start[0] = np.median(found)
    floor = max(0.3 / radius, 0.01)
    # least absolute deviations first: the biweight alone would hold on to a poor start
    start = _least_absolute(_HARMONICS[known], found, start, floor)
    fit = fit_robust(_HARMONICS[known], found, start, floor)
    inliers = fit.weights > 0
    sharp = fit.sigma <= max(MAX_SPREAD, 0.8 / radius)
    many = np.count_nonzero(inliers) >= max(MIN_INLIER_SHARE * known.sum(), MIN_VALID_SHARE * RAYS)
    # the slope of a step of contrast k, blurred over two steps and smoothed: about k / 6 and more
    contrast = 6.0 * float(np.median(edges.slope[known]))
    if not (sharp and many and contrast >= MIN_CONTRAST):
        return None
    return np.asarray(guess.center_px + arms[known][inliers] * found[inliers, None])


def _least_absolute(design: Array, values: Array, start: Array, floor: float) -> Array:
    x = start
    for _ in range(6):
        weights = 1 / np.maximum(np.abs(values - design @ x), floor)
        weighted = design.T * weights
        ridge = 1e-6 * np.eye(len(x)) * weights.sum()
        x = np.linalg.solve(weighted @ design + ridge, weighted @ values)
    return x


_THETA = np.arange(RAYS) * (2 * math.pi / RAYS)
_UNIT = np.stack([np.cos(_THETA), np.sin(_THETA)], axis=1)
_HARMONICS = np.stack(
    [np.ones(RAYS), np.cos(_THETA), np.sin(_THETA), np.cos(2 * _THETA), np.sin(2 * _THETA)], axis=1
)
