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
from rgbd_wire.quaternion import Quaternion, Vector, conjugate, multiplied, rotate, to_vector

Array: TypeAlias = NDArray[np.float64]

UNIT_QUATERNION_TOLERANCE = 1e-3
"""How far from one a quaternion's norm may be before it is refused and not normalised."""


def vec3(v: Array) -> Vector:
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
    flat = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.array(flat).reshape(3, 3)  # in half the time of an array of rows


def quaternion_from_rotation(rotation: Array) -> Array:
    """Unit quaternion (4,) ``wxyz`` with ``w >= 0`` of a rotation matrix (3, 3).

    Takes the largest of the four components first, so that nothing is divided by a small number
    (S. W. Shepperd, "Quaternion from rotation matrix", 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    trace = a + e + i
    if trace >= max(a, e, i):
        w, x, y, z = 1 + trace, h - f, c - g, d - b
    elif a >= max(e, i):
        w, x, y, z = h - f, 1 + a - e - i, d + b, g + c
    elif e >= i:
        w, x, y, z = c - g, b + d, 1 + e - i - a, h + f
    else:
        w, x, y, z = d - b, c + g, f + h, 1 + i - a - e
    n = math.copysign(math.sqrt(w * w + x * x + y * y + z * z), w)
    return np.array((w / n, x / n, y / n, z / n))


def rotation_from_vector(rotation_vector: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad] (Rodrigues)."""
    x, y, z = vec3(rotation_vector)
    angle = math.sqrt(x * x + y * y + z * z)
    # sin(angle) / angle and (1 - cos(angle)) / angle^2, whose limits are 1 and a half
    a = 1.0 if angle < 1e-8 else math.sin(angle) / angle
    b = 0.5 if angle < 1e-8 else 2.0 * (math.sin(0.5 * angle) / angle) ** 2
    flat = (
        *(1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y),
        *(b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x),
        *(b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)),
    )
    return np.array(flat).reshape(3, 3)


def vector_from_rotation(rotation: Array) -> Array:
    """Rotation vector (3,) [rad], of length at most pi, of a rotation matrix (3, 3)."""
    w, x, y, z = quaternion_from_rotation(rotation).tolist()
    return np.array(to_vector((w, x, y, z)))


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
        x, y, z = t.tolist()
        w, a, b, c = q.tolist()
        norm = math.hypot(w, a, b, c)
        if not (_all_finite(x, y, z) and math.isfinite(norm)):
            raise GeometryError(f"a pose must be finite: translation {t}, q_wxyz {q}")
        if abs(norm - 1.0) > UNIT_QUATERNION_TOLERANCE:
            raise GeometryError(f"q_wxyz must have unit length, not {norm:.6g}")
        self._keep((x, y, z), (w / norm, a / norm, b / norm, c / norm))

    def _keep(self, translation: Vector, q_wxyz: Quaternion) -> None:
        """Hold these, for good: finite, and of unit length."""
        t, q = np.array(translation), np.array(q_wxyz)
        t.flags.writeable = False
        q.flags.writeable = False
        object.__setattr__(self, "translation", t)
        object.__setattr__(self, "q_wxyz", q)

    @classmethod
    def _of(cls, translation: Vector, q_wxyz: Quaternion) -> Pose:
        """Of what was worked out of poses: only rounding is to be taken out, or too large a sum.

        Raises:
            GeometryError: the sum is not finite.
        """
        if not _all_finite(*translation):
            raise GeometryError(f"a pose must be finite: translation {translation}")
        w, x, y, z = q_wxyz
        n = math.sqrt(w * w + x * x + y * y + z * z)
        pose = object.__new__(cls)
        pose._keep(translation, (w / n, x / n, y / n, z / n))
        return pose

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
        w, x, y, z = self.q_wxyz.tolist()
        back = conjugate((w, x, y, z))
        a, b, c = rotate(back, vec3(self.translation))
        return Pose._of((-a, -b, -c), back)

    @overload
    def __matmul__(self, other: Pose) -> Pose: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: Pose | Array) -> Pose | Array:
        """Compose with a pose, or map points (3,) or (N, 3)."""
        if not isinstance(other, Pose) and np.ndim(other) != 1:
            return np.asarray(other @ self.rotation.T + self.translation)
        w, x, y, z = self.q_wxyz.tolist()
        place = other.translation if isinstance(other, Pose) else other
        a, b, c = rotate((w, x, y, z), vec3(place))
        d, e, f = vec3(self.translation)
        if not isinstance(other, Pose):
            return np.array((a + d, b + e, c + f))
        qw, qx, qy, qz = other.q_wxyz.tolist()
        return Pose._of((a + d, b + e, c + f), multiplied((w, x, y, z), (qw, qx, qy, qz)))

    def turned_since(self, before: Pose) -> Vector:
        """Rotation vector [rad] in ``a``, of length at most pi, from another attitude to this."""
        qw, qx, qy, qz = self.q_wxyz.tolist()
        pw, px, py, pz = before.q_wxyz.tolist()
        return to_vector(multiplied((qw, qx, qy, qz), conjugate((pw, px, py, pz))))

    def interpolate(self, other: Pose, s: float) -> Pose:
        """The pose at ``s`` in [0, 1] between this one and ``other``: LERP and SLERP."""
        t = self.translation + s * (other.translation - self.translation)
        return Pose(t, slerp(self.q_wxyz, other.q_wxyz, s))


def quaternion_product(p_wxyz: Array, q_wxyz: Array) -> Array:
    """Hamilton product (4,) ``wxyz``, normalised."""
    pw, px, py, pz = p_wxyz.tolist()
    qw, qx, qy, qz = q_wxyz.tolist()
    w, x, y, z = multiplied((pw, px, py, pz), (qw, qx, qy, qz))
    n = math.sqrt(w * w + x * x + y * y + z * z)
    return np.array((w / n, x / n, y / n, z / n))


def _all_finite(x: float, y: float, z: float) -> bool:
    return math.isfinite(x) and math.isfinite(y) and math.isfinite(z)
