"""The one place where north-east-down meets east-north-up, and forward-right-down forward-left-up.

Both changes of axes are their own inverse (half turns), so each function here goes both ways:

- world: ENU (x east, y north, z up) and NED (x north, y east, z down) differ by a half turn about
  the line between east and north: ``(x, y, z) -> (y, x, -z)``;
- body: FLU and FRD differ by a half turn about x: ``(x, y, z) -> (x, -y, -z)``.

What MAVLink calls LOCAL_FRD is NED with a "north" of the sender's choice: the same axes here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rgbd_wire.geometry import Array, Pose, quaternion_product

_HALF = math.sqrt(0.5)
Q_NED_FROM_ENU_WXYZ = np.array([0.0, _HALF, _HALF, 0.0])
"""A half turn about (1, 1, 0)."""
Q_FRD_FROM_FLU_WXYZ = np.array([0.0, 1.0, 0.0, 0.0])
"""A half turn about x."""
NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
TRIANGLE = np.triu_indices(6)
"""Upper triangle of a (6, 6) matrix by rows: MAVLink's 21 numbers of a covariance."""


def swap_world(v: Array) -> Array:
    """A vector (3,) of ENU in NED, or one of NED in ENU."""
    x, y, z = v
    return np.array([y, x, -z])


def swap_body(v: Array) -> Array:
    """A vector (3,) of FLU in FRD, or one of FRD in FLU."""
    x, y, z = v
    return np.array([x, -y, -z])


def swap_attitude(q_wxyz: Array) -> Array:
    """Quaternion (4,) ``wxyz`` of ENU-from-FLU as NED-from-FRD, or the other way round; w >= 0."""
    q = quaternion_product(quaternion_product(Q_NED_FROM_ENU_WXYZ, q_wxyz), Q_FRD_FROM_FLU_WXYZ)
    return -q if q[0] < 0 else q


def swap_pose(pose: Pose) -> Pose:
    """``world_from_body`` in ENU and FLU as the one in NED and FRD, or the other way round."""
    return Pose(swap_world(pose.translation), swap_attitude(pose.q_wxyz))


def swap_yaw_rate(yaw_rate_radps: float) -> float:
    """Rate about up, seen from above counter-clockwise, as the one about down, or back."""
    return -yaw_rate_radps


def triangle_from_covariance(covariance: Array) -> list[float]:
    """MAVLink's 21 numbers, in NED, of a covariance (6, 6) in ENU.

    Translation first, then the rotation vector about the world's axes, both ways.
    """
    swapped = _swap_covariance(covariance)
    return [float(c) for c in swapped[TRIANGLE]]


def covariance_from_triangle(triangle: Sequence[float]) -> Array | None:
    """Covariance (6, 6) in ENU of MAVLink's 21 numbers in NED; None: it is not said.

    A variance that is not finite stands for "not known". PX4 sends the six variances alone, and
    NaN for all that lies beside them: nothing is known to go together.
    """
    upper = np.asarray(triangle, dtype=np.float64)
    if upper.shape != (21,):
        return None
    full = np.zeros((6, 6))
    full[TRIANGLE] = upper
    if not np.isfinite(np.diag(full)).all():
        return None
    full[~np.isfinite(full)] = 0.0
    full = full + full.T - np.diag(np.diag(full))
    return _swap_covariance(full)


def _swap_covariance(covariance: Array) -> Array:
    # A half turn is a proper rotation: rotation vectors change their axes as places do
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = NED_FROM_ENU
    return np.asarray(both @ covariance @ both.T)
