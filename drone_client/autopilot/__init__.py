"""What takes velocity commands and says how the vehicle is.

NED, FRD and MAVLink exist in this package alone; what goes in and out is ENU and FLU.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.geometry import Array, Pose


@dataclass(frozen=True, slots=True, eq=False)
class VelocityCommand:
    """What the drone should do until the next command."""

    velocity_world: Array  # (3,) [m/s], ENU
    """Of the body."""
    yaw_rate_radps: float
    """About world z, counter-clockwise seen from above."""
    t_ns: int
    """When it was computed, drone's monotonic clock."""


@dataclass(frozen=True, slots=True, eq=False)
class VehicleState:
    """What the autopilot said last of the vehicle; all times on the drone's monotonic clock."""

    t_heard_ns: int
    """Last heartbeat: how old all of this is at most."""
    mode: str
    """As pilots know it: OFFBOARD, POSCTL, AUTO.LAND, GUIDED."""
    armed: bool
    obeying: bool
    """It flies our commands now: armed, and in the mode that takes them."""
    t_pose_ns: int | None = None
    """When its own estimate of the pose was valid; None: it gave none yet."""
    world_from_body: Pose | None = None
    """Its own estimate."""
    velocity_world: Array | None = None  # (3,) [m/s]
    """Of the body."""
    battery_fraction: float | None = None
    """0 to 1; None: not said."""
    landed: bool | None = None
    failsafe: str = ""
    """Which failsafe acts, in words; empty: none."""
    pose_resets: int = 0
    """How often its estimate of the pose has jumped on purpose; a change means that it has."""


class Autopilot(Protocol):
    """Flies velocity commands."""

    def command(self, command: VelocityCommand) -> None:
        """Take the newest command; never blocks, never raises."""
        ...


class FlyingAutopilot(Autopilot, Protocol):
    """An autopilot of a real or a simulated vehicle. Every method returns at once, none raises."""

    @property
    def reason(self) -> str:
        """In words: where asking for the vehicle stands, and why."""
        ...

    @property
    def idle(self) -> bool:
        """Whether it neither asks for the vehicle nor flies it: not engaged, or it gave up."""
        ...

    def state(self) -> VehicleState | None:
        """The newest state; None: never heard."""
        ...

    def engage(self) -> None:
        """Ask for the mode that takes commands; arms nothing. ``state().obeying`` tells."""
        ...

    def release(self) -> None:
        """Give the vehicle back: ask for the mode that holds its position, then fall silent."""
        ...

    def give_odometry(self, sample: OdometrySample) -> None:
        """Pass the robot's own odometry to the autopilot's estimator."""
        ...

    def give_range(self, sample: RangeSample) -> None:
        """Pass a distance to its estimator."""
        ...

    def close(self) -> None:
        """End its threads and its line."""
        ...
