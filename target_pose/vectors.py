"""Three-vectors: what numpy does in ten times the time, since it is made for many at once."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]


def length(v: Array) -> float:
    """Length of a vector (3,)."""
    return math.sqrt(float(v @ v))


def unit(v: Array) -> Array:
    """A vector (3,) over its length, which must not be zero."""
    return np.asarray(v / length(v))


def angle(a: Array, b: Array) -> float:
    """Angle [rad] between two unit vectors (3,)."""
    return math.acos(min(max(float(a @ b), -1.0), 1.0))


def cross(a: Array, b: Array) -> Array:
    """Cross product (3,)."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def orthogonal_to(v: Array) -> tuple[Array, Array]:
    """Two unit vectors (3,) that make a right-handed frame with a unit vector (3,)."""
    least = np.zeros(3)
    least[int(np.abs(v).argmin())] = 1.0
    first = unit(cross(v, least))
    return first, cross(v, first)
