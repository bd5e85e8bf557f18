"""Unit quaternions as tuples ``wxyz``, where numpy's calls would be the cost.

``q`` stands for ``a_from_b``, as ``rgbd_wire.geometry.Pose.q_wxyz``, which is worked out here.
"""

from __future__ import annotations

import math
from typing import TypeAlias

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


def rotate(q: Quaternion, v: Vector) -> Vector:
    """``v`` of ``b`` in ``a``."""
    w, x, y, z = q
    a, b, c = v
    # t = 2 q_vec x v; v + w t + q_vec x t
    s = 2.0 * (y * c - z * b)
    t = 2.0 * (z * a - x * c)
    u = 2.0 * (x * b - y * a)
    return (
        a + w * s + y * u - z * t,
        b + w * t + z * s - x * u,
        c + w * u + x * t - y * s,
    )


def rotate_back(q: Quaternion, v: Vector) -> Vector:
    """``v`` of ``a`` in ``b``."""
    w, x, y, z = q
    return rotate((w, -x, -y, -z), v)


def multiplied(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product, as it comes: its length is off by rounding."""
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product, normalised."""
    w, x, y, z = multiplied(p, q)
    n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return (w * n, x * n, y * n, z * n)


def from_vector(v: Vector) -> Quaternion:
    """Of a rotation vector [rad]."""
    x, y, z = v
    angle = math.sqrt(x * x + y * y + z * z)
    # sin(a/2) / a, whose limit at zero is a half
    s = 0.5 - angle * angle / 48.0 if angle < 1e-3 else math.sin(0.5 * angle) / angle
    return (math.cos(0.5 * angle), s * x, s * y, s * z)


def to_vector(q: Quaternion) -> Vector:
    """Rotation vector [rad] of the short way."""
    w, x, y, z = q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    sine = math.sqrt(x * x + y * y + z * z)
    s = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return (s * x, s * y, s * z)


def conjugate(q: Quaternion) -> Quaternion:
    """``b_from_a``."""
    w, x, y, z = q
    return (w, -x, -y, -z)


def about_up(angle_rad: float) -> Quaternion:
    """A turn about z, counter-clockwise seen from above."""
    return (math.cos(0.5 * angle_rad), 0.0, 0.0, math.sin(0.5 * angle_rad))
