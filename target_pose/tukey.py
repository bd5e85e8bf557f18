"""Robust weighted least squares: Tukey's biweight by iterative reweighting."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

TUKEY = 4.685
"""In standard deviations: 95 % efficient on Gaussian errors (P. J. Huber, "Robust Statistics")."""
MAD_TO_SIGMA = 1.4826
CONVERGED = 0.02
"""Largest change of a fitted value, in standard deviations, that ends the reweighting."""
_RIDGE = 1e-12
"""Relative ridge on the normal equations: a singular problem gives a useless but finite answer."""


class RobustFit(NamedTuple):
    """A linear model fitted to data with outliers."""

    coefficients: Array  # (K,)
    weights: Array  # (N,)
    """In [0, 1]; 0 for outliers."""
    sigma: float
    """Robust standard deviation of the residuals."""


def tukey_weights(residuals: Array, sigma: float) -> Array:
    """Biweights (N,) in [0, 1]: 0 past 4.685 standard deviations."""
    scaled = residuals / (TUKEY * sigma)
    return np.asarray(np.square(np.maximum(1 - scaled * scaled, 0.0)))


def robust_sigma(residuals: Array, floor: float) -> float:
    """Standard deviation from the median absolute residual (about zero), at least ``floor``."""
    middle = len(residuals) // 2
    # the upper median: one partition, a fifth of what np.median takes on short arrays
    return max(MAD_TO_SIGMA * float(np.partition(np.abs(residuals), middle)[middle]), floor)


def solve_weighted(design: Array, values: Array, weights: Array) -> Array:
    """Weighted least squares (K,) of ``design`` (N, K) @ x = ``values`` (N,)."""
    weighted = design.T * weights
    normal = weighted @ design
    normal.flat[:: len(normal) + 1] += _RIDGE * max(float(np.trace(normal)), 1e-300)
    return np.asarray(np.linalg.solve(normal, weighted @ values))


def fit_robust(
    design: Array, values: Array, start: Array, floor: float, iterations: int = 8
) -> RobustFit:
    """Fit ``design`` (N, K) @ x = ``values`` (N,) from a start (K,) that most data agree with.

    ``floor`` is the least standard deviation believed.
    """
    x = start
    for _ in range(iterations):
        residuals = values - design @ x
        sigma = robust_sigma(residuals, floor)
        following = solve_weighted(design, values, tukey_weights(residuals, sigma))
        change = np.abs(design @ (following - x)).max(initial=0.0)
        x = following
        if change < CONVERGED * sigma:
            break
    residuals = values - design @ x
    sigma = robust_sigma(residuals, floor)
    return RobustFit(x, tukey_weights(residuals, sigma), sigma)
