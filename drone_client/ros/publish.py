"""What of a flight goes to ROS 2: each accepted measurement of the target, in the world."""

from __future__ import annotations

from drone_client.reception import Reception
from drone_client.ros.zenoh import RosPoses
from drone_client.settings import ClientSettings, split_endpoints
from rgbd_wire.clock import Clock


def open_ros(settings: ClientSettings, clock: Clock) -> RosPoses | None:
    """The publisher that the settings ask for; None: they name no topic.

    Raises:
        LinkError: a topic or an endpoint that cannot be one.
    """
    if settings.ros_topic is None:
        return None
    return RosPoses(
        settings.name,
        split_endpoints(settings.ros_connect),
        settings.ros_topic,
        clock,
        flavour=settings.ros_flavour,
        domain=settings.ros_domain,
    )


def publish_accepted(poses: RosPoses, reception: Reception) -> None:
    """Publish an accepted result, if it has a target and the drone knew where it was."""
    measurement = reception.measurement
    if measurement is not None:
        poses.publish(
            measurement.world_from_target, measurement.covariance, measurement.t_capture_ns
        )
