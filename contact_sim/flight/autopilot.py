"""The simulated vehicle as the client's autopilot."""

from __future__ import annotations

from dataclasses import replace

from contact_sim.flight.live import LiveSimulation
from contact_sim.vehicle.estimator import Estimate
from drone_client.autopilot import VehicleState, VelocityCommand
from drone_client.autopilot.offboard_rules import OffboardRules
from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.clock import Clock


def vehicle_state(
    estimate: Estimate, rules: OffboardRules, t_heard_ns: int, offset_ns: int
) -> VehicleState:
    """What the autopilot says of itself.

    Args:
        estimate: stamped in simulated time.
        rules: its mode.
        t_heard_ns: drone's clock.
        offset_ns: drone's clock minus simulated time.
    """
    valid = estimate.valid
    return VehicleState(
        t_heard_ns=t_heard_ns,
        mode=rules.mode,
        armed=rules.armed,
        obeying=rules.obeying,
        t_pose_ns=estimate.t_ns + offset_ns if valid else None,
        world_from_body=estimate.world_from_body if valid else None,
        velocity_world=estimate.velocity_world if valid else None,
        battery_fraction=0.9,
        landed=not rules.armed,
        failsafe=rules.failsafe,
        pose_resets=estimate.resets,
    )


class SimulatedVehicle:
    """A ``FlyingAutopilot`` whose motors turn in MuJoCo; may be called from any thread."""

    def __init__(self, live: LiveSimulation, clock: Clock) -> None:
        self._live = live
        self._clock = clock

    @property
    def reason(self) -> str:
        """The mode is there at once."""
        return self._live.rules.reason

    @property
    def idle(self) -> bool:
        """Whether it is in another mode than ours."""
        return self._live.rules.idle

    def command(self, command: VelocityCommand) -> None:
        """Take the newest command."""
        with self._live.look():
            self._live.rules.command(command, self._clock.now_ns())

    def state(self) -> VehicleState | None:
        """What its estimator believes, in the world of the odometry."""
        live = self._live
        with live.look() as (simulation, offset_ns):
            return vehicle_state(simulation.estimate, live.rules, live.heard_ns, offset_ns)

    def engage(self) -> None:
        """Into the mode that takes commands."""
        with self._live.look():
            self._live.rules.engage(self._clock.now_ns())

    def release(self) -> None:
        """Into the mode that holds the position."""
        with self._live.look():
            self._live.rules.release()

    def give_odometry(self, sample: OdometrySample) -> None:
        """Pass the VIO's pose to the estimator, on simulated time."""
        with self._live.look() as (simulation, offset_ns):
            simulation.give_odometry(replace(sample, t_ns=sample.t_ns - offset_ns))

    def give_range(self, sample: RangeSample) -> None:
        """Pass a distance to the estimator, on simulated time."""
        with self._live.look() as (simulation, offset_ns):
            simulation.give_range(replace(sample, t_ns=sample.t_ns - offset_ns))

    def close(self) -> None:
        """Let the simulation stand still."""
        self._live.stop()
