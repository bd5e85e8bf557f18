"""A vehicle in memory, for tests and dry runs: it follows velocities late, and keeps the rules.

Kinematic: the velocity and the yaw rate follow what is commanded with a first-order lag, solved
exactly between two moments, so that it makes no difference how often it is looked at.
"""

from __future__ import annotations

import math
import threading

import numpy as np

from drone_client.autopilot import VehicleState, VelocityCommand
from drone_client.autopilot.dead_man import DeadManSettings, Setpoint
from drone_client.autopilot.offboard_rules import OffboardRules
from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.clock import Clock
from rgbd_wire.geometry import Array, Pose

STEP_NS = 5_000_000


class SimulatedAutopilot:
    """A ``FlyingAutopilot`` that moves as the clock does; may be called from several threads."""

    def __init__(
        self,
        clock: Clock,
        world_from_body: Pose,
        *,
        lag_s: float = 0.3,
        armed: bool = True,
        dead_man: DeadManSettings | None = None,
    ) -> None:
        """Stand still at a place, in the mode in which a pilot flies.

        Args:
            clock: the drone's.
            world_from_body: where; its heading is kept, roll and pitch are level from now on.
            lag_s: time constant of the velocity.
            armed: whether the motors run.
            dead_man: ages and limits.
        """
        if lag_s < 0.0:
            raise ValueError(f"lag_s = {lag_s} is negative")
        self.given_odometry: OdometrySample | None = None
        """The newest that was given."""
        self.given_range: RangeSample | None = None
        self._rules = OffboardRules(armed=armed, dead_man=dead_man)
        self._clock = clock
        self._lag_s = lag_s
        self._lock = threading.Lock()
        self._t_ns = clock.now_ns()
        self._position: Array = world_from_body.translation.copy()
        forward = world_from_body.rotation[:, 0]
        self._yaw_rad = math.atan2(forward[1], forward[0])
        self._velocity: Array = np.zeros(3)
        self._yaw_rate_radps = 0.0

    @property
    def mode(self) -> str:
        """As pilots know it; set it to switch the mode as a pilot does."""
        return self._rules.mode

    @mode.setter
    def mode(self, mode: str) -> None:
        self._rules.mode = mode

    @property
    def armed(self) -> bool:
        """Whether the motors run."""
        return self._rules.armed

    @armed.setter
    def armed(self, armed: bool) -> None:
        self._rules.armed = armed

    @property
    def failsafe(self) -> str:
        """Which failsafe acts; empty: none."""
        return self._rules.failsafe

    @failsafe.setter
    def failsafe(self, failsafe: str) -> None:
        self._rules.failsafe = failsafe

    @property
    def refused(self) -> int:
        """Commands that counted as none."""
        return self._rules.refused

    def command(self, command: VelocityCommand) -> None:
        """Take the newest command; never blocks, never raises."""
        with self._lock:
            now_ns = self._clock.now_ns()
            self._move(now_ns)
            self._rules.command(command, now_ns)

    @property
    def reason(self) -> str:
        """The mode is there at once."""
        return self._rules.reason

    @property
    def idle(self) -> bool:
        """Whether it is in another mode than ours."""
        return self._rules.idle

    def state(self) -> VehicleState:
        """The state now."""
        with self._lock:
            now_ns = self._clock.now_ns()
            self._move(now_ns)
            half = self._yaw_rad / 2.0
            q_wxyz = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
            return VehicleState(
                t_heard_ns=now_ns,
                mode=self._rules.mode,
                armed=self._rules.armed,
                obeying=self._rules.obeying,
                t_pose_ns=now_ns,
                world_from_body=Pose(self._position, q_wxyz),
                velocity_world=self._velocity.copy(),
                battery_fraction=1.0,
                landed=not self._rules.armed,
                failsafe=self._rules.failsafe,
            )

    def engage(self) -> None:
        """Into the mode that takes commands."""
        with self._lock:
            now_ns = self._clock.now_ns()
            self._move(now_ns)
            self._rules.engage(now_ns)

    def release(self) -> None:
        """Into the mode that holds the position."""
        with self._lock:
            self._move(self._clock.now_ns())
            self._rules.release()

    def give_odometry(self, sample: OdometrySample) -> None:
        """Keep it, for a test to look at."""
        self.given_odometry = sample

    def give_range(self, sample: RangeSample) -> None:
        """Keep it, for a test to look at."""
        self.given_range = sample

    def close(self) -> None:
        """There is nothing to end."""

    def _move(self, now_ns: int) -> None:
        """Fly from the last moment to this one; the dead man is asked every 5 ms."""
        while self._t_ns < now_ns:
            step_ns = min(STEP_NS, now_ns - self._t_ns)
            self._advance(self._rules.wanted(self._t_ns), step_ns / 1e9)
            self._t_ns += step_ns

    def _advance(self, wanted: Setpoint, dt_s: float) -> None:
        # dv/dt = (u - v) / T for a constant u: v moves towards u by 1 - exp(-dt/T), and the place
        # by u dt + (v - u) T (1 - exp(-dt/T))
        goal = np.array(wanted.velocity_world)
        share = 1.0 if self._lag_s == 0.0 else -math.expm1(-dt_s / self._lag_s)
        area_s = self._lag_s * share
        self._position = self._position + goal * dt_s + (self._velocity - goal) * area_s
        self._velocity = self._velocity + (goal - self._velocity) * share
        rate = wanted.yaw_rate_radps
        self._yaw_rad += rate * dt_s + (self._yaw_rate_radps - rate) * area_s
        self._yaw_rate_radps += (rate - self._yaw_rate_radps) * share
