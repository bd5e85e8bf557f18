"""The robot's own VIO and lidars that the command line asks for."""

from __future__ import annotations

from drone_client.odometry.zenoh import RosOdometry
from drone_client.settings import ClientSettings, split_endpoints
from rgbd_wire.clock import Clock


def open_odometry(
    settings: ClientSettings,
    clock: Clock,
    *,
    vio_topic: str | None = None,
    lidar_topic: str | None = None,
    ahead_topic: str | None = None,
) -> RosOdometry | None:
    """The source of the topics; None: no topic is named.

    Args:
        settings: where ROS 2 is (``ros_connect``, ``ros_flavour``, ``ros_domain``).
        clock: the drone's.
        vio_topic: of ``nav_msgs/Odometry``.
        lidar_topic: of ``sensor_msgs/Range``, looking down.
        ahead_topic: of ``sensor_msgs/Range``, looking forward.

    Raises:
        LinkError: a topic or an endpoint that cannot be one.
    """
    if vio_topic is lidar_topic is ahead_topic is None:
        return None
    return RosOdometry(
        split_endpoints(settings.ros_connect),
        clock,
        vio_topic=vio_topic,
        lidar_topic=lidar_topic,
        ahead_topic=ahead_topic,
        flavour=settings.ros_flavour,
        domain=settings.ros_domain,
    )
