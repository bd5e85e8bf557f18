"""The real drone's own: its camera, its autopilot, its VIO and lidars."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drone_client.autopilot import FlyingAutopilot
from drone_client.autopilot.choose import open_autopilot
from drone_client.odometry.choose import open_odometry
from drone_client.odometry.source import OdometrySource
from drone_client.settings import ClientSettings
from drone_client.source import LiveSource
from drone_client.source.choose import open_live
from rgbd_wire.clock import Clock


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """What is flown with."""

    camera: LiveSource
    vehicle: FlyingAutopilot
    odometry: OdometrySource | None
    """None: the autopilot has its own."""

    def close(self) -> None:
        """Close the line to the autopilot, whatever becomes of the rest."""
        try:
            if self.odometry is not None:
                self.odometry.close()
        finally:
            self.vehicle.close()


def open_robot(
    source: str,
    camera: Path | None,
    autopilot: str,
    settings: ClientSettings,
    clock: Clock,
    vio_topic: str | None,
    lidar_topic: str | None,
    ahead_topic: str | None,
) -> Robot:
    """Open what the command line names.

    Raises:
        ClientError: of the part that there is not, or that cannot be opened.
    """
    live = open_live(source, clock, camera=camera)
    vehicle = open_autopilot(autopilot, clock)
    try:
        odometry = open_odometry(
            settings,
            clock,
            vio_topic=vio_topic,
            lidar_topic=lidar_topic,
            ahead_topic=ahead_topic,
        )
    except BaseException:
        vehicle.close()
        raise
    return Robot(live, vehicle, odometry)
