"""What takes velocity commands. NED, FRD and MAVLink exist in this package alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from rgbd_wire.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class VelocityCommand:
    """What the drone should do until the next command."""

    velocity_world: Array  # (3,) [m/s], ENU
    """Of the body."""
    yaw_rate_radps: float
    """About world z, counter-clockwise seen from above."""
    t_ns: int
    """When it was computed, drone's monotonic clock."""


class Autopilot(Protocol):
    """Flies velocity commands."""

    def command(self, command: VelocityCommand) -> None:
        """Take the newest command; never blocks, never raises."""
        ...
