"""A vehicle that hears nothing of us: its state is real, the commands are only shown."""

from __future__ import annotations

from drone_client.autopilot import FlyingAutopilot, VehicleState, VelocityCommand
from drone_client.odometry import OdometrySample, RangeSample


class Unheard:
    """A ``FlyingAutopilot`` to look at: state comes through, nothing goes out."""

    def __init__(self, vehicle: FlyingAutopilot) -> None:
        self._vehicle = vehicle
        self.last: VelocityCommand | None = None
        """The newest command, which was not sent."""

    def command(self, command: VelocityCommand) -> None:
        """Remember the command."""
        self.last = command

    @property
    def reason(self) -> str:
        """Nothing is asked for."""
        return "a dry run"

    @property
    def idle(self) -> bool:
        """Never: a dry run goes on without the vehicle."""
        return False

    def state(self) -> VehicleState | None:
        """The vehicle's own."""
        return self._vehicle.state()

    def engage(self) -> None:
        """Nothing: the mode stays as it is."""

    def release(self) -> None:
        """Nothing."""

    def give_odometry(self, sample: OdometrySample) -> None:
        """Nothing: its estimator is not ours to feed in a dry run."""

    def give_range(self, sample: RangeSample) -> None:
        """Nothing."""

    def close(self) -> None:
        """Close the line to the vehicle."""
        self._vehicle.close()
