"""Rigid transforms, and the closed set of frames they connect.

Frames (docs/frames.md): ``world`` ENU, ``body`` FLU, ``camera`` RDF (x right, y down, z forward),
``tip`` (end of the arm, axes as ``body``), ``target`` (origin in the centre of the printed target,
x out of the board towards the viewer, z up along the board, y left). PX4's NED/FRD exists in
``drone_client/autopilot`` alone.

A transform is named ``a_from_b``: ``p_a = a_from_b @ p_b``, neighbours cancel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.errors import GeometryError

Array: TypeAlias = NDArray[np.float64]

UNIT_QUATERNION_TOLERANCE = 1e-3
"""How far from one a quaternion's norm may be before it is refused and not normalised."""


def vec3(v: Array) -> tuple[float, float, float]:
    """A vector (3,) as plain floats, for arithmetic that is quicker without arrays."""
    x, y, z = v.tolist()
    return x, y, z


def skew(v: Array) -> Array:
    """The (3, 3) matrix whose product with ``w`` is ``v x w``."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_from_quaternion(q_wxyz: Array) -> Array:
    """Rotation matrix (3, 3) of a unit quaternion (4,) in ``wxyz`` order."""
    w, x, y, z = q_wxyz.tolist()  # plain floats multiply several times faster than numpy's
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: Array) -> Array:
    """Unit quaternion (4,) ``wxyz`` with ``w >= 0`` of a rotation matrix (3, 3).

    Takes the largest of the four components first, so that nothing is divided by a small number
    (S. W. Shepperd, "Quaternion from rotation matrix", 1978).
    """
    m = rotation
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    squares = np.array([trace, m[0, 0], m[1, 1], m[2, 2]])
    largest = int(np.argmax(squares))
    q = np.empty(4)
    if largest == 0:
        q[:] = 1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = m[k, j] - m[j, k]
        q[1 + i] = 1 + m[i, i] - m[j, j] - m[k, k]
        q[1 + j] = m[j, i] + m[i, j]
        q[1 + k] = m[k, i] + m[i, k]
    q /= np.linalg.norm(q)
    return -q if q[0] < 0 else q


def rotation_from_vector(rotation_vector: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(rotation_vector))
    k = skew(rotation_vector)
    if angle < 1e-8:
        return np.eye(3) + k + 0.5 * k @ k
    a = math.sin(angle) / angle
    b = (1 - math.cos(angle)) / (angle * angle)
    return np.eye(3) + a * k + b * k @ k


def vector_from_rotation(rotation: Array) -> Array:
    """Rotation vector (3,) [rad], of length at most pi, of a rotation matrix (3, 3)."""
    q_wxyz = quaternion_from_rotation(rotation)
    axis = q_wxyz[1:]
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.asarray(2.0 * axis)
    return np.asarray(2.0 * math.atan2(sine, q_wxyz[0]) / sine * axis)


def slerp(q0_wxyz: Array, q1_wxyz: Array, s: float) -> Array:
    """Quaternion (4,) ``wxyz`` at ``s`` in [0, 1] of the short way from ``q0`` to ``q1``.

    K. Shoemake, "Animating rotation with quaternion curves", 1985.
    """
    dot = float(q0_wxyz @ q1_wxyz)
    q1 = -q1_wxyz if dot < 0 else q1_wxyz
    dot = min(abs(dot), 1.0)
    if dot > 0.9995:
        q = q0_wxyz + s * (q1 - q0_wxyz)
    else:
        angle = math.acos(dot)
        q = (math.sin((1 - s) * angle) * q0_wxyz + math.sin(s * angle) * q1) / math.sin(angle)
    return np.asarray(q / np.linalg.norm(q))


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rigid transform ``a_from_b``: rotation, then translation.

    Raises:
        GeometryError: a value is not finite, or the quaternion is not of unit length.
    """

    translation: Array  # (3,) [m]
    """Origin of ``b`` in ``a``."""
    q_wxyz: Array  # (4,)
    """Unit quaternion of the rotation, ``wxyz``."""

    def __post_init__(self) -> None:
        t = np.asarray(self.translation, dtype=np.float64)
        q = np.asarray(self.q_wxyz, dtype=np.float64)
        if t.shape != (3,) or q.shape != (4,):
            raise GeometryError(f"a pose takes shapes (3,) and (4,), not {t.shape} and {q.shape}")
        # Plain floats: poses are made hundreds of times a second, and numpy's calls would cost most
        wxyz = q.tolist()
        if not all(map(math.isfinite, t.tolist() + wxyz)):
            raise GeometryError(f"a pose must be finite: translation {t}, q_wxyz {q}")
        norm = math.hypot(*wxyz)
        if abs(norm - 1.0) > UNIT_QUATERNION_TOLERANCE:
            raise GeometryError(f"q_wxyz must have unit length, not {norm:.6g}")
        q = q / norm
        t = t.copy()
        t.flags.writeable = False
        q.flags.writeable = False
        object.__setattr__(self, "translation", t)
        object.__setattr__(self, "q_wxyz", q)

    @classmethod
    def identity(cls) -> Pose:
        """The transform that changes nothing."""
        return cls(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))

    @classmethod
    def from_rotation(cls, rotation: Array, translation: Array) -> Pose:
        """From a rotation matrix (3, 3) and a translation (3,) [m]."""
        return cls(translation, quaternion_from_rotation(np.asarray(rotation, dtype=np.float64)))

    @classmethod
    def from_matrix(cls, matrix: Array) -> Pose:
        """From a homogeneous matrix (4, 4).

        Raises:
            GeometryError: the matrix is not a rigid transform to 1e-3.
        """
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape != (4, 4) or not np.isfinite(m).all():
            raise GeometryError(f"a rigid transform is a finite (4, 4) matrix, not {m.shape}")
        r = m[:3, :3]
        rigid = np.allclose(r @ r.T, np.eye(3), atol=1e-3) and np.linalg.det(r) > 0
        if not rigid or not np.allclose(m[3], (0, 0, 0, 1), atol=1e-6):
            raise GeometryError("the (4, 4) matrix is not a rigid transform")
        return cls.from_rotation(r, m[:3, 3])

    @property
    def rotation(self) -> Array:
        """Rotation matrix, (3, 3)."""
        return rotation_from_quaternion(self.q_wxyz)

    @property
    def matrix(self) -> Array:
        """Homogeneous matrix, (4, 4)."""
        m = np.eye(4)
        m[:3, :3] = self.rotation
        m[:3, 3] = self.translation
        return m

    def inverse(self) -> Pose:
        """``b_from_a`` of ``a_from_b``."""
        conjugate = self.q_wxyz * np.array([1.0, -1.0, -1.0, -1.0])
        return Pose(-(rotation_from_quaternion(conjugate) @ self.translation), conjugate)

    @overload
    def __matmul__(self, other: Pose) -> Pose: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: Pose | Array) -> Pose | Array:
        """Compose with a pose, or map points (3,) or (N, 3)."""
        if isinstance(other, Pose):
            q = quaternion_product(self.q_wxyz, other.q_wxyz)
            return Pose(self.rotation @ other.translation + self.translation, q)
        return np.asarray(other @ self.rotation.T + self.translation)

    def interpolate(self, other: Pose, s: float) -> Pose:
        """The pose at ``s`` in [0, 1] between this one and ``other``: LERP and SLERP."""
        t = self.translation + s * (other.translation - self.translation)
        return Pose(t, slerp(self.q_wxyz, other.q_wxyz, s))


def quaternion_product(p_wxyz: Array, q_wxyz: Array) -> Array:
    """Hamilton product (4,) ``wxyz``, normalised."""
    pw, px, py, pz = p_wxyz.tolist()
    qw, qx, qy, qz = q_wxyz.tolist()
    r = np.array(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ]
    )
    return np.asarray(r / np.linalg.norm(r))
