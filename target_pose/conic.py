"""The two poses from which a circle of known radius looks like a given ellipse."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

MIN_FLATNESS = 1e-9
"""Ratio of the conic's eigenvalues under which it is a line or a point, not an ellipse."""


class CirclePose(NamedTuple):
    """A circle in space, in the camera frame."""

    center: Array  # (3,) [m]
    normal: Array  # (3,)
    """Unit normal of its plane, towards the camera."""


def conic_of_circle(circle: CirclePose, radius_m: float) -> Array:
    """The conic (3, 3) to which a circle projects: ``circle_poses`` backwards.

    A ray d meets the circle's plane in d (n.c)/(n.d); that this point is a radius from the centre
    is a quadratic form in d.
    """
    center, normal = circle
    a = float(normal @ center) * np.eye(3) - np.outer(center, normal)
    return np.asarray(a.T @ a - radius_m**2 * np.outer(normal, normal))


def other_fold(circle: CirclePose, radius_m: float) -> CirclePose:
    """The other circle that looks the same; the same one where it is seen along its axis."""
    poses = circle_poses(conic_of_circle(circle, radius_m), radius_m)
    if poses is None:
        return circle
    return min(poses, key=lambda p: float(p.normal @ circle.normal))


def circle_poses(conic: Array, radius_m: float) -> tuple[CirclePose, CirclePose] | None:
    """Both circles that project to a conic: its two folds.

    ``conic`` (3, 3) is symmetric with ``p @ conic @ p = 0`` for every ray p = (x/z, y/z, 1) of the
    ellipse; its scale and sign do not matter. The cone over the ellipse is diagonalised; the planes
    that cut a cone in circles contain its middle axis (Q. Chen, H. Wu, T. Wada, "Camera calibration
    with two arbitrary coplanar circles", 2004). docs/localisation.md has the derivation.

    Returns:
        The two poses, equal where the circle is seen along its axis; None if the conic is no
        ellipse in front of the camera.
    """
    scale = float(np.abs(conic).max())
    if not 0 < scale < math.inf:  # false for NaN, too
        return None
    eigenvalues, axes = np.linalg.eigh(conic / scale)
    if eigenvalues[1] < 0:
        eigenvalues, axes = -eigenvalues[::-1], axes[:, ::-1]
    l3, l2, l1 = (float(e) for e in eigenvalues)
    if not (l3 < -MIN_FLATNESS * l1 and l2 > MIN_FLATNESS * l1):
        return None
    major, minor = axes[:, 2], axes[:, 0]
    g = math.sqrt((l2 - l3) / (l1 - l3))
    h = math.sqrt(max(l1 - l2, 0.0) / (l1 - l3))
    far = radius_m / math.sqrt(-l1 * l3)
    first, second = (
        _facing(far * (s * l3 * h * major - l1 * g * minor), s * h * major - g * minor)
        for s in (1.0, -1.0)
    )
    if min(first.center[2], second.center[2]) <= 0:
        return None
    return first, second


def _facing(center: Array, normal: Array) -> CirclePose:
    """Of the four signs the one in front of the camera that faces it."""
    if center[2] < 0:
        center = -center
    if normal @ center > 0:
        normal = -normal
    return CirclePose(center, normal)
