"""6x6 covariances of a pose: built from information, widened, always positive definite.

Order: translation, then rotation vector, both in the camera frame and independent perturbations:
``translation + d`` and ``rotation_from_vector(r) @ rotation``.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.geometry import Pose, vector_from_rotation
from target_pose.vectors import length, unit

Array: TypeAlias = NDArray[np.float64]

MAX_TILT_SIGMA_RAD = 0.6
"""The normal is known at least this well from the target being seen at all."""
MAX_RANGE_SHARE = 0.5
"""Standard deviation of the position over its range, for the same reason."""
MIN_SIGMA_M = 2e-4
MIN_SIGMA_RAD = 1e-3
"""No printed board is flatter."""
BEARING_SIGMA_RAD = 5e-4
"""Error of a camera's calibration across the line of sight: a fifth to a third of a pixel."""


def covariance_from_information(
    information: Array, normal: Array, center: Array, roll_sigma_rad: float
) -> Array:
    """Covariance (6, 6) of an information matrix (6, 6) that says nothing about the roll."""
    range_m = length(center)
    about_normal = np.outer(normal, normal)
    prior = np.zeros((6, 6))
    prior[:3, :3] = np.eye(3) / (MAX_RANGE_SHARE * range_m) ** 2
    prior[3:, 3:] = (np.eye(3) - about_normal) / MAX_TILT_SIGMA_RAD**2
    prior[3:, 3:] += about_normal / roll_sigma_rad**2
    covariance = np.asarray(np.linalg.inv(information + prior))
    covariance[:3, :3] += _along(center / range_m, 0.0, BEARING_SIGMA_RAD * range_m)
    return floored(covariance)


def covariance_along(
    center: Array,
    normal: Array,
    *,
    range_sigma_m: float,
    lateral_sigma_m: float,
    tilt_sigma_rad: float,
    roll_sigma_rad: float,
) -> Array:
    """Covariance (6, 6) from deviations along and across the line of sight, tilt and roll."""
    ray = unit(center)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = _along(ray, range_sigma_m, lateral_sigma_m)
    covariance[3:, 3:] = _along(normal, roll_sigma_rad, tilt_sigma_rad)
    return floored(covariance)


def widened(covariance: Array, offset: Array, share: float = 1.0) -> Array:
    """Covariance (6, 6) that also reaches ``share`` of an offset (6,) squared."""
    return np.asarray(covariance + share * np.outer(offset, offset))


def pose_offset(from_pose: Pose, to_pose: Pose) -> Array:
    """The perturbation (6,) that takes one pose to another."""
    turn = to_pose.rotation @ from_pose.rotation.T
    return np.concatenate([to_pose.translation - from_pose.translation, vector_from_rotation(turn)])


def floored(covariance: Array) -> Array:
    """Symmetric, and at least as wide as the least errors believed."""
    floor = np.repeat([MIN_SIGMA_M**2, MIN_SIGMA_RAD**2], 3)
    return np.asarray(0.5 * (covariance + covariance.T) + np.diag(floor))


def _along(axis: Array, along: float, across: float) -> Array:
    outer = np.outer(axis, axis)
    return np.asarray(along**2 * outer + across**2 * (np.eye(3) - outer))
