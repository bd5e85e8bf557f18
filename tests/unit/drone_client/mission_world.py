"""A world to fly a whole mission in: a vehicle that lags, an arm on a spring, a board, a worker.

Everything between the worker's answer and the velocity command is the real thing (target filter,
mission, guidance, safety filter); the vehicle is a model for the mathematics, not for aerodynamics.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from drone_client.airframe import Airframe
from drone_client.autopilot import VehicleState
from drone_client.cbf import FilterSettings
from drone_client.control import ControlSettings, Decision, OnMission, decide
from drone_client.mission import MissionSettings, Order, Phase, Reason, Senses, Transition, begin
from drone_client.mission.arm import AT_REST, Base
from drone_client.target import TargetEstimate, measure, update
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import MS, SECOND, pose

TICK_NS = 20 * MS
TICK_S = 0.02
FRAME_TICKS = 5
"""A camera of 10 Hz"""
ANSWER_TICKS = 6
"""whose frames are answered after 120 ms."""
LAG_S = 0.3
DELAY_TICKS = 2
MASS_KG = 3.3
VIO_NOISE_M = 0.0005
SIGMA_M, SIGMA_PER_M, SIGMA_RAD = 0.0003, 0.001, 0.005
"""Of a measured place, beside that per metre of range, and of a measured attitude."""
BOARD = pose((5, 0, 1.5), (0, 0, np.pi))
"""Faces west: its x is the world's -x."""
TARGET_FROM_WORLD = BOARD.inverse()
FLYING = VehicleState(0, "OFFBOARD", armed=True, obeying=True, battery_fraction=0.8, landed=False)


@dataclass
class World:
    """The flight so far; a test changes its flags between two ticks."""

    seed: int = 0
    start: tuple[float, float, float] = (3.0, 0.15, 1.6)
    """Of the body, in the world."""
    settings: ControlSettings = field(default_factory=ControlSettings)

    link: bool = True
    """The worker answers."""
    sees: bool = True
    """The target is in view."""
    vehicle: VehicleState | None = FLYING
    order: Order = Order.GO
    jumped: bool = False
    """What the odometry's watch says: until the first measurement from after the jump."""
    wrong_by: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Error of the next measurement [m]; then it is right again."""

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.airframe = Airframe()
        self.body, self.yaw = np.array(self.start), 0.1
        self.velocity, self.yaw_rate, self.arm = np.zeros(3), 0.0, AT_REST
        self.vio_from_world = Pose.identity()
        self.tick = 0
        self.commands = [(np.zeros(3), 0.0)] * DELAY_TICKS
        self.in_flight: list[tuple[int, int, Pose, Pose, float]] = []
        self.estimate: TargetEstimate | None = None
        self.jumped_tick = -1
        self.mission = begin(0)
        self.tips: list[np.ndarray] = []
        self.closing: list[float] = []
        self.decisions: list[Decision] = []
        self.transitions: list[Transition] = []

    @property
    def now_ns(self) -> int:
        return self.tick * TICK_NS

    @property
    def phase(self) -> Phase:
        return self.mission.phase

    @property
    def world_from_body(self) -> Pose:
        return pose(self.body, (0, 0, self.yaw))

    @property
    def tip(self) -> np.ndarray:
        """The true unloaded tip in frame ``target``."""
        tip_world = self.world_from_body @ self.airframe.body_from_tip.translation
        return TARGET_FROM_WORLD @ tip_world

    @property
    def reasons(self) -> list[Reason]:
        return [t.reason for t in self.transitions]

    @property
    def phases(self) -> list[Phase]:
        return [t.after for t in self.transitions]

    def jump(self, by: Pose) -> None:
        """The odometry's world moves."""
        self.vio_from_world = by @ self.vio_from_world
        self.jumped, self.jumped_tick = True, self.tick

    def fly(self, seconds: float) -> World:
        """So long, or until the mission is over and the vehicle has come to rest."""
        for _ in range(round(seconds / TICK_S)):
            self.step()
            if self.phase.final and self.mission.given_back and abs(self.velocity).max() < 1e-3:
                break
        return self

    def fly_until(self, phase: Phase, seconds: float = 60.0, *, settled_s: float = 0.2) -> World:
        """Until a phase has lasted a little."""
        for _ in range(round(seconds / TICK_S)):
            self.step()
            if self.phase is phase and self.now_ns - self.mission.since_ns >= settled_s * SECOND:
                return self
        raise AssertionError(f"never {phase}: {self.transitions}")

    def step(self) -> None:
        """One tick: see, decide, fly."""
        self.tick += 1
        seen_from = self.vio_from_world @ self.world_from_body
        noise = VIO_NOISE_M * self.rng.normal(size=3)
        odometry = Pose(seen_from.translation + noise, seen_from.q_wxyz)
        self._look(odometry)
        vehicle = self.vehicle and replace(self.vehicle, t_heard_ns=self.now_ns)
        senses = Senses(vehicle=vehicle, odometry_jumped=self.jumped, order=self.order)
        decision = decide(
            self.now_ns,
            self.estimate,
            odometry,
            self.airframe,
            self.settings,
            OnMission(self.mission, senses),
        )
        self.mission = decision.mission
        if self.mission.transition is not None:
            self.transitions.append(self.mission.transition)
        self.decisions.append(decision)
        turn = self.vio_from_world.rotation.T  # the command is in the odometry's world
        command = (turn @ decision.command.velocity_world, decision.command.yaw_rate_radps)
        if vehicle is None or not vehicle.obeying:
            command = (np.zeros(3), 0.0)  # whoever has it holds it
        self.commands.append(command)
        self._move(*self.commands.pop(0))
        self.tips.append(self.tip)

    def _look(self, odometry: Pose) -> None:
        if self.tick % FRAME_TICKS == 0 and self.link and self.sees:
            camera_from_target = (
                self.world_from_body @ self.airframe.body_from_camera
            ).inverse() @ BOARD
            error = np.array(self.wrong_by)
            self.wrong_by = (0.0, 0.0, 0.0)
            sigma_m = SIGMA_M + SIGMA_PER_M * np.linalg.norm(camera_from_target.translation)
            seen = camera_from_target @ pose(
                sigma_m * self.rng.normal(size=3) + error, SIGMA_RAD * self.rng.normal(size=3)
            )
            at = odometry @ self.airframe.body_from_camera
            self.in_flight.append((self.tick + ANSWER_TICKS, self.tick, at, seen, sigma_m))
        for answer in [a for a in self.in_flight if a[0] <= self.tick]:
            self.in_flight.remove(answer)
            _, captured, at, seen, sigma_m = answer
            if not self.link or captured < self.jumped_tick:
                continue
            covariance = np.diag([sigma_m**2] * 3 + [SIGMA_RAD**2] * 3)
            measurement = measure(at, seen, covariance, captured * TICK_NS)
            prior = None if self.jumped else self.estimate
            self.estimate, _ = update(prior, measurement)
            self.jumped = False

    def _move(self, velocity_command: np.ndarray, yaw_rate_command: float) -> None:
        out = BOARD.rotation[:, 0]
        steps = 5
        for _ in range(steps):
            dt = TICK_S / steps
            acceleration = (velocity_command - self.velocity) / LAG_S
            tip = self.tip
            arm = self.settings.mission.contact.arm
            if tip[0] < 0.0:
                acceleration = acceleration + out * arm.force_n(self.arm) / MASS_KG
            self.velocity = self.velocity + dt * acceleration
            self.yaw_rate += dt / LAG_S * (yaw_rate_command - self.yaw_rate)
            self.body = self.body + dt * self.velocity
            self.yaw += dt * self.yaw_rate
            before, after = tip[0], self.tip[0]
            closing = (before - after) / dt
            self.arm = arm.touched(self.arm, Base(-float(after), closing, 0.0), dt)
            if before > 0.0 >= after:
                self.closing.append(closing)


def controls(**mission: object) -> ControlSettings:
    """Settings with another mission in them."""
    return ControlSettings(mission=MissionSettings(**mission), filter=FilterSettings())
