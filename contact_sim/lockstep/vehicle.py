"""The simulated vehicle where nobody else steps it: the client's interfaces, on simulated time."""

from __future__ import annotations

from contact_sim.flight.autopilot import vehicle_state
from contact_sim.simulation import Simulation
from drone_client.autopilot import VehicleState, VelocityCommand
from drone_client.autopilot.dead_man import Setpoint
from drone_client.autopilot.offboard_rules import OffboardRules
from drone_client.odometry import OdometrySample, RangeSample


class LockstepVehicle:
    """Vehicle, estimator's food and odometry source in one; not thread-safe.

    The drone's clock is simulated time.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.rules = OffboardRules()
        self._simulation = simulation
        self._flown: Setpoint | None = None

    def command(self, command: VelocityCommand) -> None:
        """Take the newest command."""
        self.rules.command(command, self._simulation.t_ns)

    def turn(self, steps: int) -> None:
        """Fly for some physics steps."""
        wanted = self.rules.wanted(self._simulation.t_ns)
        if wanted is not self._flown:
            self._simulation.set_velocity(wanted.velocity_world, wanted.yaw_rate_radps)
            self._flown = wanted
        self._simulation.step(steps)

    def state(self) -> VehicleState | None:
        """What the estimator believes."""
        simulation = self._simulation
        return vehicle_state(simulation.estimate, self.rules, simulation.t_ns, 0)

    def give_odometry(self, sample: OdometrySample) -> None:
        """To the estimator."""
        self._simulation.give_odometry(sample)

    def give_range(self, sample: RangeSample) -> None:
        """To the estimator."""
        self._simulation.give_range(sample)

    def odometry(self) -> OdometrySample | None:
        """The newest of the VIO."""
        return self._simulation.vio

    def height(self) -> RangeSample | None:
        """The newest of the lidar that looks down."""
        return self._simulation.height

    def ahead(self) -> RangeSample | None:
        """The newest of the lidar that looks forward."""
        return self._simulation.ahead

    def close(self) -> None:
        """There is nothing to end."""
