"""The bytes of ``geometry_msgs/PoseStamped`` and ``PoseWithCovarianceStamped``: little-endian CDR.

::

    encapsulation  00 01 00 00 (plain CDR, little-endian, no options)
    stamp          i32 seconds, u32 nanoseconds, of Unix time
    frame_id       u32 length with its NUL, UTF-8, NUL; then up to the next multiple of 8
    position       3 f64, x y z [m]
    orientation    4 f64, x y z w (ours is w x y z)
    covariance     36 f64 by rows, ``PoseWithCovarianceStamped`` alone

Alignment counts from behind the encapsulation (XCDR version 1 of OMG DDS-XTypes).

**The covariance goes over as it is.** Ours is of a perturbation from the left: the position moves
by ``d`` and the attitude by a rotation vector ``f``, ``R' = exp(f) R``, both along the axes of the
parent frame, in the order d, f (``TargetPose.covariance`` in the camera's axes, ``TargetEstimate``
in the world's). ROS wants (x, y, z, rotation about X, Y, Z) with fixed axes, those of
``header.frame_id``: the same three small turns, about the same axes, applied on the same side. For
small angles their order does not matter, so a rotation vector and fixed-axis angles agree to first
order (they part by about half the product of two angles: 2 mrad at 60 mrad), and a covariance
knows first order alone. What is not small, such as the roll of a round target that nothing showed,
is large in either notation and says "unknown". It is **not** the covariance of roll, pitch and yaw
of the pose itself.
"""

from __future__ import annotations

import struct

from rgbd_wire.geometry import Array, Pose

_ENCAPSULATION = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_POSE = struct.Struct("<7d")
_COVARIANCE = struct.Struct("<36d")
_NS_PER_S = 1_000_000_000


def pose_stamped(unix_ns: int, frame_id: str, pose: Pose) -> bytes:
    """CDR of a ``geometry_msgs/PoseStamped``.

    Args:
        unix_ns: when the pose was true, Unix time [ns].
        frame_id: the parent frame, without NUL.
        pose: ``frame_from_target``.

    Raises:
        ValueError: the time does not fit into 32-bit seconds, or the frame holds a NUL.
    """
    header = _header(unix_ns, frame_id)
    x, y, z = pose.translation.tolist()
    qw, qx, qy, qz = pose.q_wxyz.tolist()
    return _ENCAPSULATION + header + _POSE.pack(x, y, z, qx, qy, qz, qw)


def pose_with_covariance_stamped(
    unix_ns: int, frame_id: str, pose: Pose, covariance: Array
) -> bytes:
    """CDR of a ``geometry_msgs/PoseWithCovarianceStamped``.

    Args:
        unix_ns: when the pose was true, Unix time [ns].
        frame_id: the parent frame, without NUL.
        pose: ``frame_from_target``.
        covariance: (6, 6), translation then rotation vector in the parent frame's axes, of a
            perturbation from the left [m^2, m rad, rad^2].

    Raises:
        ValueError: as ``pose_stamped``, or the covariance is not (6, 6).
    """
    if covariance.shape != (6, 6):
        raise ValueError(f"the covariance has the shape {covariance.shape}, expected (6, 6)")
    return pose_stamped(unix_ns, frame_id, pose) + _COVARIANCE.pack(*covariance.ravel().tolist())


def _header(unix_ns: int, frame_id: str) -> bytes:
    seconds, nanoseconds = divmod(unix_ns, _NS_PER_S)
    if not -(2**31) <= seconds < 2**31:
        raise ValueError(f"{seconds} s of Unix time do not fit into 32 bits")
    if "\0" in frame_id:
        raise ValueError(f"the frame {frame_id!r} holds a NUL")
    text = frame_id.encode() + b"\0"
    header = _STAMP.pack(seconds, nanoseconds) + _LENGTH.pack(len(text)) + text
    return header + bytes(-len(header) % 8)
