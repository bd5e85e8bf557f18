"""Knowing where we are: the robot's own odometry and its lidar, as samples on the drone's clock."""

from __future__ import annotations

from dataclasses import dataclass

from rgbd_wire.geometry import Array, Pose


@dataclass(frozen=True, slots=True, eq=False)
class OdometrySample:
    """One estimate of the robot's motion, from VIO or from the autopilot's own filter."""

    t_ns: int
    """When it was valid, drone's monotonic clock."""
    world_from_body: Pose
    """ENU and FLU."""
    velocity_world: Array  # (3,) [m/s]
    """Of the body."""
    covariance: Array | None = None  # (6, 6), world axes, translation then rotation vector
    """Of the pose; None: not said."""
    resets: int = 0
    """How often the source has jumped on purpose (MAVLink's reset_counter): a change of it means
    that the world moved, not the robot."""


@dataclass(frozen=True, slots=True)
class RangeSample:
    """One distance from a one-dimensional lidar."""

    t_ns: int
    """Drone's monotonic clock."""
    distance_m: float
    min_m: float = 0.1
    """Below it, and above ``max_m``, the sensor sees nothing."""
    max_m: float = 12.0
    looks_down: bool = True
    """Towards the ground; otherwise forward, along the body's x."""

    @property
    def valid(self) -> bool:
        """Whether it is a distance that the sensor can measure."""
        return self.min_m <= self.distance_m <= self.max_m
