"""The little vector algebra that the filter needs, on tuples of three floats."""

from __future__ import annotations

import math
from typing import TypeAlias

Vec3: TypeAlias = tuple[float, float, float]
"""A point [m] or a velocity [m/s]; its frame stands in the name of the variable."""

ZERO: Vec3 = (0.0, 0.0, 0.0)


def dot(a: Vec3, b: Vec3) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec3, b: Vec3) -> Vec3:
    """Vector product ``a x b``."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def norm(a: Vec3) -> float:
    """Euclidean length."""
    return math.hypot(a[0], a[1], a[2])


def scaled(a: Vec3, k: float) -> Vec3:
    """``k a``."""
    return a[0] * k, a[1] * k, a[2] * k


def moved(a: Vec3, b: Vec3, k: float = 1.0) -> Vec3:
    """``a + k b``."""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


def is_bounded(a: Vec3, limit: float) -> bool:
    """Whether every component is a number of at most ``limit`` in magnitude.

    Comparisons alone, so that NaN and infinity answer False and nothing can raise.
    """
    x, y, z = a
    return -limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit
