"""ROS messages as samples: their frames are REP 103's, their stamps Unix time of this machine."""

from __future__ import annotations

import numpy as np

from drone_client.odometry import OdometrySample, RangeSample
from drone_client.ros.cdr_read import RosOdometry, RosRange
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Array, Pose

AGE_MAX_NS = 1_000_000_000
"""A stamp further back is of another clock, or of no use."""
AHEAD_MAX_NS = 20_000_000
"""A stamp that is ahead by up to this is of now."""
MAX_VARIANCE = 1e4


class SampleError(ValueError):
    """A message that makes no sample; its text is the reason that is counted."""


def odometry_sample(message: RosOdometry, unix_now_ns: int, now_ns: int) -> OdometrySample:
    """The pose of the body in the VIO's world, which is level (REP 105's ``odom``).

    The twist is told in the child's frame and turned into the world. A covariance that is all
    zeros, negative or no number is ROS's way to say nothing.

    Args:
        message: as it came.
        unix_now_ns: Unix time now, of the same clock as the stamp.
        now_ns: the same moment on the drone's monotonic clock.

    Raises:
        SampleError: ``stamp``, ``not_a_pose`` or ``not_a_number``.
    """
    t_ns = drone_ns(message.unix_ns, unix_now_ns, now_ns)
    try:
        world_from_body = Pose(message.position, message.q_wxyz)
    except GeometryError:
        raise SampleError("not_a_pose") from None
    if not np.isfinite(message.velocity_child).all():
        raise SampleError("not_a_number")
    velocity_world = world_from_body.rotation @ message.velocity_child
    covariance = usable_covariance(message.pose_covariance)
    return OdometrySample(t_ns, world_from_body, velocity_world, covariance)


def range_sample(
    message: RosRange, unix_now_ns: int, now_ns: int, *, looks_down: bool
) -> RangeSample:
    """A distance; whether it is one is for ``Lidar`` to say.

    Raises:
        SampleError: ``stamp``.
    """
    t_ns = drone_ns(message.unix_ns, unix_now_ns, now_ns)
    return RangeSample(t_ns, message.range_m, message.min_m, message.max_m, looks_down)


def drone_ns(unix_ns: int, unix_now_ns: int, now_ns: int) -> int:
    """A stamp on the drone's monotonic clock.

    Raises:
        SampleError: ``stamp``: it is too old, or of the future.
    """
    age_ns = unix_now_ns - unix_ns
    if not -AHEAD_MAX_NS <= age_ns <= AGE_MAX_NS:
        raise SampleError("stamp")
    return now_ns - max(age_ns, 0)


def usable_covariance(covariance: Array) -> Array | None:
    """The covariance (6, 6), or None where it says nothing."""
    if not np.isfinite(covariance).all():
        return None
    variances = np.diag(covariance)
    if not ((variances > 0.0).all() and (variances <= MAX_VARIANCE).all()):
        return None
    return np.asarray(0.5 * (covariance + covariance.T))
