"""An ellipse through points: the direct least-squares fit, with weights."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

MIN_POINTS = 6


def fit_ellipse(xy: Array, weights: Array | None = None) -> Array | None:
    """The conic (3, 3), symmetric, of the ellipse nearest to points (N, 2) in algebraic distance.

    The constraint 4AC - B^2 = 1 makes it an ellipse whatever the points (A. Fitzgibbon, M. Pilu,
    R. Fisher, 1999), solved in the numerically stable split form (R. Halir, J. Flusser, 1998).

    Returns:
        C with ``p @ C @ p = 0`` for p = (x, y, 1) on the ellipse, in the points' own units; None
        for fewer than six points, or points on a line.
    """
    if weights is None:
        weights = np.ones(len(xy))
    used = weights > 0
    if np.count_nonzero(used) < MIN_POINTS or not np.isfinite(xy[used]).all():
        return None
    xy, weights = xy[used], weights[used]
    total = float(weights.sum())
    center = weights @ xy / total
    spread = math.sqrt(float(weights @ np.square(xy - center).sum(axis=1)) / total)
    if spread < 1e-12:
        return None
    x, y = ((xy - center) / spread).T
    quadratic = np.stack([x * x, x * y, y * y], axis=1)
    linear = np.stack([x, y, np.ones_like(x)], axis=1)
    s1 = (quadratic.T * weights) @ quadratic
    s2 = (quadratic.T * weights) @ linear
    s3 = (linear.T * weights) @ linear
    try:
        t = -np.linalg.solve(s3, s2.T)
        m = s1 + s2 @ t
        _, vectors = np.linalg.eig(np.array([m[2] / 2, -m[1], m[0] / 2]))
    except np.linalg.LinAlgError:
        return None
    vectors = vectors.real
    is_ellipse = 4 * vectors[0] * vectors[2] - vectors[1] ** 2
    best = int(is_ellipse.argmax())
    if not is_ellipse[best] > 1e-9:
        return None
    a, b, c = vectors[:, best]
    d, e, f = t @ vectors[:, best]
    local = np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]])
    to_local = np.array(
        [
            [1 / spread, 0.0, -center[0] / spread],
            [0.0, 1 / spread, -center[1] / spread],
            [0.0, 0.0, 1.0],
        ]
    )
    return np.asarray(to_local.T @ local @ to_local)
