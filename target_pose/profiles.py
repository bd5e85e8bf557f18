"""Grey-value profiles across an edge, and where along them the edge lies to a part of a pixel."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

SMOOTHING_STEPS = 1.5
"""Standard deviation of the derivative-of-Gaussian filter, in steps of the profile."""
_HALF = 4
_TAPS = np.arange(-_HALF, _HALF + 1, dtype=np.float64)
_GAUSS = np.exp(-0.5 * (_TAPS / SMOOTHING_STEPS) ** 2)
_DERIVATIVE = _TAPS * _GAUSS / (_TAPS**2 * _GAUSS).sum()
"""Correlated with a ramp of slope one per step this gives one."""


class ProfileEdges(NamedTuple):
    """The strongest edge of each profile; all are NaN where there is none."""

    at: Array  # (N,)
    """Position along the profile, in steps from its first sample."""
    slope: Array  # (N,)
    """Steepest slope, positive, in grey values per step."""


def gray_values(image: NDArray[np.uint8], uv: Array) -> Array:
    """Bilinear grey values (...) at pixels (..., 2) of a picture (H, W); NaN outside of it.

    Written out because ``cv2.remap`` rounds positions to 1/32 of a pixel.
    """
    height, width = image.shape
    u, v = uv[..., 0], uv[..., 1]
    inside: NDArray[np.bool_] | None = None
    # false for NaN, too
    if not (u.min() >= 0 and v.min() >= 0 and u.max() <= width - 1 and v.max() <= height - 1):
        with np.errstate(invalid="ignore"):
            inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
    left = np.minimum(u.astype(np.intp), max(width - 2, 0))
    top = np.minimum(v.astype(np.intp), max(height - 2, 0))
    fu, fv = u - left, v - top
    at = top * width + left
    right = 1 if width > 1 else 0
    below = width if height > 1 else 0
    flat = image.ravel()
    upper = flat.take(at) * (1 - fu) + flat.take(at + right) * fu
    at += below
    lower = flat.take(at) * (1 - fu) + flat.take(at + right) * fu
    gray = upper * (1 - fv) + lower * fv
    return np.asarray(gray if inside is None else np.where(inside, gray, np.nan))


def slopes(profiles: Array) -> Array:
    """Smoothed derivative (N, M - 8) of profiles (N, M), per step.

    One NaN makes the whole profile NaN.
    """
    return np.asarray(profiles @ _derivative_matrix(profiles.shape[1]))


@lru_cache(maxsize=64)
def _derivative_matrix(length: int) -> Array:
    """The filter as a band matrix (M, M - 8): one small product is faster than a convolution."""
    matrix = np.zeros((length, length - 2 * _HALF))
    for column in range(matrix.shape[1]):
        matrix[column : column + len(_TAPS), column] = _DERIVATIVE
    matrix.flags.writeable = False
    return matrix


def strongest_edges(signed_slopes: Array) -> ProfileEdges:
    """The steepest rise of each profile, from its slopes (N, M) as ``slopes`` gives them.

    A blurred step has a Gaussian slope, whose logarithm is a parabola: three samples about the
    steepest give its peak exactly. Edges at the window's ends do not count; profiles with NaN
    (outside the picture) have none.
    """
    count, length = signed_slopes.shape
    usable = np.asarray(np.isfinite(signed_slopes).all(axis=1))
    s = np.where(usable[:, None], signed_slopes, 0.0)
    peak = s.argmax(axis=1)
    rows = np.arange(count)
    middle = np.clip(peak, 1, length - 2)
    before, top, after = s[rows, middle - 1], s[rows, middle], s[rows, middle + 1]
    good = usable & (peak == middle) & (before > 0) & (after > 0)
    with np.errstate(all="ignore"):
        a, b, c = (np.log(np.where(good, x, 1.0)) for x in (before, top, after))
        bend = a - 2 * b + c
        good &= bend < 0
        offset = np.where(good, 0.5 * (a - c) / np.where(good, bend, 1.0), np.nan)
    at = middle + offset + _HALF
    return ProfileEdges(at, np.where(good, top, np.nan))


def blur_variance(signed_slopes: Array, edges: ProfileEdges) -> float:
    """Variance [steps^2] of the Gaussian that blurs a set of alike edges, smoothing taken out.

    The profiles' slopes are averaged after they are aligned on their edges; the width is read at
    the peak's flanks from the logarithm, as in ``strongest_edges`` but three steps wide.

    Returns:
        The variance, or NaN when there is no edge to measure.
    """
    known = np.isfinite(edges.at)
    if not known.any():
        return math.nan
    s = signed_slopes[known]
    shifts = np.arange(-3, 4)
    where = edges.at[known, None] - _HALF + shifts
    length = s.shape[1]
    fits = (where[:, 0] >= 0) & (where[:, -1] <= length - 1)
    if not fits.any():
        return math.nan
    where, s = where[fits], s[fits]
    low = np.minimum(where.astype(np.intp), length - 2)
    part = where - low
    rows = np.arange(len(s))[:, None]
    aligned = s[rows, low] * (1 - part) + s[rows, low + 1] * part
    middle = len(aligned) // 2
    # the median, for some of the profiles may cross something else
    mean = np.partition(aligned, middle, axis=0)[middle]
    if not (mean > 0).all():
        return math.nan
    # weighted parabola through log(mean) over the seven shifts: curvature is -1/variance
    weight = mean**2
    basis = np.stack([np.ones(7), shifts, -0.5 * shifts**2])
    normal = (basis * weight) @ basis.T
    inverse_variance = np.linalg.solve(normal, (basis * weight) @ np.log(mean))[2]
    if inverse_variance <= 0:
        return math.nan
    return float(max(1 / inverse_variance - SMOOTHING_STEPS**2, 0.0))
