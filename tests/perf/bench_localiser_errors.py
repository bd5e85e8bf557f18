"""How far a pose is from the truth, in metres, radians, and in its own standard deviations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.geometry import Array, Pose, rotation_from_vector

DEGREES_OF_FREEDOM = {"position": 3, "normal": 2, "pose": 5, "roll": 1}
"""Of the squared Mahalanobis errors; ``pose`` is position and normal with their correlation."""


@dataclass(frozen=True, eq=False)
class Error:
    """The perturbation that takes an estimate to the truth, by parts."""

    position_m: NDArray[np.float64]  # (3,), camera frame
    normal_rad: NDArray[np.float64]  # (2,), about two axes on the estimated board
    roll_rad: float
    """About the normal, in [-pi, pi]."""
    axes: NDArray[np.float64]  # (3, 3), rows: the two axes and the estimated normal

    @property
    def position_mm(self) -> float:
        """Distance of the two centres."""
        return 1000 * float(np.linalg.norm(self.position_m))

    @property
    def normal_deg(self) -> float:
        """Angle between the two normals."""
        return math.degrees(float(np.linalg.norm(self.normal_rad)))


def pose_error(estimate: Pose, truth: Pose) -> Error:
    """What is between an estimated and the true ``camera_from_target``."""
    normal, up = estimate.rotation[:, 0], estimate.rotation[:, 2]
    axes = np.array([up, np.cross(normal, up), normal])
    turn = _shortest_turn(normal, truth.rotation[:, 0])
    # with the tilt taken back, what is left of the rotation is about the normal
    true_up = rotation_from_vector(-turn) @ truth.rotation[:, 2]
    roll = math.atan2(float(np.cross(up, true_up) @ normal), float(up @ true_up))
    return Error(truth.translation - estimate.translation, axes[:2] @ turn, roll, axes)


def squared_mahalanobis(error: Error, covariance: Array) -> dict[str, float]:
    """Squared error over covariance (6, 6), translation first, by ``DEGREES_OF_FREEDOM``."""
    into_parts = np.zeros((6, 6))
    into_parts[:3, :3] = np.eye(3)
    into_parts[3:, 3:] = error.axes
    c = into_parts @ covariance @ into_parts.T
    whole = np.concatenate([error.position_m, error.normal_rad, [error.roll_rad]])
    parts = {
        "position": slice(0, 3),
        "normal": slice(3, 5),
        "pose": slice(0, 5),
        "roll": slice(5, 6),
    }
    return {
        name: float(whole[part] @ np.linalg.solve(c[part, part], whole[part]))
        for name, part in parts.items()
    }


def _shortest_turn(a: Array, b: Array) -> NDArray[np.float64]:
    """Rotation vector (3,) that takes unit vector ``a`` to ``b`` about what is normal to both."""
    across = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(across)), float(a @ b)
    if sine < 1e-12:
        if cosine > 0:
            return np.zeros(3)
        across = np.cross(a, np.eye(3)[int(np.abs(a).argmin())])
        return np.asarray(math.pi * across / np.linalg.norm(across))
    return np.asarray(math.atan2(sine, cosine) * across / sine)
