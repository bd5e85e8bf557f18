"""A vehicle in memory, for tests and dry runs: it follows velocities late, and keeps the rules.

Kinematic: the velocity and the yaw rate follow what is commanded with a first-order lag, solved
exactly between two moments, so that it makes no difference how often it is looked at. The dead man
and the order of modes are the real ones, except that the mode is there at once.
"""

from __future__ import annotations

import math
import threading

import numpy as np

from drone_client.autopilot import VehicleState, VelocityCommand
from drone_client.autopilot.dead_man import (
    DeadManSettings,
    Refused,
    Setpoint,
    checked,
    leaving,
    stand_still,
)
from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.clock import Clock
from rgbd_wire.geometry import Array, Pose

LOST_AFTER_NS = 500_000_000
"""Without a setpoint for so long the vehicle holds its position by itself, as PX4's failsafe."""
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
        self.mode = "POSCTL"
        """Set it to switch the mode as a pilot does."""
        self.armed = armed
        self.failsafe = ""
        self.given_odometry: OdometrySample | None = None
        """The newest that was given."""
        self.given_range: RangeSample | None = None
        self.refused = 0
        """Commands that counted as none."""
        self._clock = clock
        self._lag_s = lag_s
        self._dead_man = dead_man or DeadManSettings()
        self._lock = threading.Lock()
        self._t_ns = clock.now_ns()
        self._position: Array = world_from_body.translation.copy()
        forward = world_from_body.rotation[:, 0]
        self._yaw_rad = math.atan2(forward[1], forward[0])
        self._velocity: Array = np.zeros(3)
        self._yaw_rate_radps = 0.0
        self._newest: Setpoint | None = None

    def command(self, command: VelocityCommand) -> None:
        """Take the newest command; never blocks, never raises."""
        with self._lock:
            now_ns = self._clock.now_ns()
            self._move(now_ns)
            newest_ns = None if self._newest is None else self._newest.t_ns
            result = checked(command, now_ns, newest_ns, self._dead_man)
            if isinstance(result, Refused):
                self.refused += 1
            else:
                self._newest = result

    @property
    def reason(self) -> str:
        """The mode is there at once."""
        return "the mode is there" if self.mode == "OFFBOARD" else "not engaged"

    @property
    def idle(self) -> bool:
        """Whether it is in another mode than ours."""
        return self.mode != "OFFBOARD"

    def state(self) -> VehicleState:
        """The state now."""
        with self._lock:
            now_ns = self._clock.now_ns()
            self._move(now_ns)
            half = self._yaw_rad / 2.0
            q_wxyz = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
            return VehicleState(
                t_heard_ns=now_ns,
                mode=self.mode,
                armed=self.armed,
                obeying=self.armed and self.mode == "OFFBOARD",
                t_pose_ns=now_ns,
                world_from_body=Pose(self._position, q_wxyz),
                velocity_world=self._velocity.copy(),
                battery_fraction=1.0,
                landed=not self.armed,
                failsafe=self.failsafe,
            )

    def engage(self) -> None:
        """Into the mode that takes commands."""
        with self._lock:
            now_ns = self._clock.now_ns()
            self._move(now_ns)
            self._newest = stand_still(now_ns)
            self.failsafe = ""
            self.mode = "OFFBOARD"

    def release(self) -> None:
        """Into the mode that holds the position."""
        with self._lock:
            self._move(self._clock.now_ns())
            if self.mode == "OFFBOARD":
                self.mode = "AUTO.LOITER"

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
            self._advance(self._wanted(), step_ns / 1e9)
            self._t_ns += step_ns

    def _wanted(self) -> Setpoint:
        still = stand_still(self._t_ns)
        if self.mode != "OFFBOARD" or not self.armed:
            return still
        if self._newest is None or self._t_ns - self._newest.t_ns > LOST_AFTER_NS:
            self.mode, self.failsafe = "AUTO.LOITER", "no setpoints"
            return still
        return leaving(self._newest, self._t_ns, self._dead_man) or still

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
