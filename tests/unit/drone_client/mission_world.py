"""A world to fly a whole mission in: a vehicle that lags, an arm on a spring, a board, a worker.

Everything between the worker's answer and the velocity command is the real thing (target filter,
mission, guidance, safety filter); the vehicle is a model for the mathematics, not for aerodynamics.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from drone_client.airframe import Airframe
from drone_client.autopilot import VehicleState
from drone_client.control import ControlSettings, Decision, OnMission, decide
from drone_client.mission import MissionSettings, Order, Phase, Reason, Senses, Transition, begin
from drone_client.mission.arm import AT_REST, Base
from drone_client.target import TargetEstimate, TargetMeasurement, measure, update
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import MS, SECOND, pose

TICK_NS = 20 * MS
TICK_S = 0.02
ANSWER_TICKS = 6
"""A frame is answered after 120 ms."""
LAG_S = 0.3
DELAY_TICKS = 2
MASS_KG = 3.3
VIO_NOISE_M = 0.0005
SIGMA_M, SIGMA_PER_M, SIGMA_RAD = 0.0003, 0.001, 0.005
"""Of a measured place, beside that per metre of range, and of a measured attitude."""
BOARD = pose((5, 0, 1.5), (0, 0, np.pi))
"""Faces west: its x is the world's -x."""
TARGET_FROM_WORLD = BOARD.inverse()
OUT_WORLD = BOARD.rotation[:, 0]
AIRFRAME = Airframe()
FLYING = VehicleState(0, "OFFBOARD", armed=True, obeying=True, battery_fraction=0.8, landed=False)


def controls(**mission: Any) -> ControlSettings:
    """Settings as they are flown, keep-outs and all, with another mission in them."""
    return ControlSettings(mission=MissionSettings(**mission), keep_outs=AIRFRAME.keep_outs)


@dataclass
class World:
    """The flight so far; a test changes its flags between two ticks."""

    seed: int = 0
    start: tuple[float, float, float] = (3.0, 0.15, 1.6)
    """Of the body, in the world."""
    settings: ControlSettings = field(default_factory=controls)

    frame_ticks: int = 5
    """A camera of 10 Hz."""
    link: bool = True
    """The worker answers."""
    sees: bool = True
    """The target is in view."""
    vehicle: VehicleState | None = FLYING
    order: Order = Order.GO
    wrong_by: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Error [m] of the next"""
    wrong: int = 0
    """so many measurements."""
    moves: bool = True
    """The vehicle flies what it is told; it may say so and not do it."""

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.body, self.yaw = np.array(self.start), 0.1
        self.velocity, self.yaw_rate, self.arm = np.zeros(3), 0.0, AT_REST
        self.vio_from_world = Pose.identity()
        self.tick = 0
        self.commands = [(np.zeros(3), 0.0)] * DELAY_TICKS
        self.in_flight: list[tuple[int, TargetMeasurement]] = []
        self.estimate: TargetEstimate | None = None
        self.epoch = 0
        self.jumped = False  # what the watch says: until a measurement from after the jump
        self.mission = begin(0)
        self.tips: list[np.ndarray] = []
        self.closing: list[float] = []
        self.decisions: list[Decision] = []
        self.outward_mps: list[float] = []
        self.transitions: list[Transition] = []

    @property
    def now_ns(self) -> int:
        return self.tick * TICK_NS

    @property
    def phase(self) -> Phase:
        return self.mission.phase

    @property
    def world_from_body(self) -> Pose:
        return Pose(self.body, np.array([math.cos(self.yaw / 2), 0, 0, math.sin(self.yaw / 2)]))

    @property
    def tip(self) -> np.ndarray:
        """The true unloaded tip in frame ``target``."""
        ahead, left, up = AIRFRAME.body_from_tip.translation
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        x, y, z = self.body + (c * ahead - s * left, s * ahead + c * left, up)
        at = BOARD.translation
        return np.array([at[0] - x, at[1] - y, z - at[2]])

    @property
    def reasons(self) -> list[Reason]:
        return [t.reason for t in self.transitions]

    @property
    def phases(self) -> list[Phase]:
        return [t.after for t in self.transitions]

    def jump(self, by: Pose, *, noticed: bool = True) -> None:
        """The odometry's world moves, and what watches it says so, or does not."""
        self.vio_from_world = by @ self.vio_from_world
        if noticed:
            self.jumped, self.epoch, self.estimate = True, self.epoch + 1, None

    def fork(self) -> World:
        """Another world that goes on from here; what is in the lists is never changed."""
        other = copy.copy(self)
        other.rng = copy.deepcopy(self.rng)
        for name, value in vars(self).items():
            if isinstance(value, list):
                setattr(other, name, list(value))
        return other

    def fly(self, seconds: float) -> World:
        """So long, or until the vehicle was given back and has come to rest."""
        for _ in range(round(seconds / TICK_S)):
            self.step()
            if self.phase.final and self.mission.given_back and abs(self.velocity).max() < 2e-3:
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
            AIRFRAME,
            self.settings,
            OnMission(self.mission, senses),
        )
        assert decision.mission is not None
        self.mission = decision.mission
        if self.mission.transition is not None:
            self.transitions.append(self.mission.transition)
        self.decisions.append(decision)
        turn = self.vio_from_world.rotation.T  # the command is in the odometry's world
        command = (turn @ decision.command.velocity_world, decision.command.yaw_rate_radps)
        self.outward_mps.append(float(OUT_WORLD @ command[0]))
        if vehicle is None or not vehicle.obeying or not self.moves:
            command = (np.zeros(3), 0.0)  # whoever has it holds it
        self.commands.append(command)
        self._move(*self.commands.pop(0))
        self.tips.append(self.tip)

    def _look(self, odometry: Pose) -> None:
        """A frame, if it is time for one; and the answers that are due."""
        if self.tick % self.frame_ticks == 0 and self.link and self.sees:
            world_from_camera = self.world_from_body @ AIRFRAME.body_from_camera
            camera_from_target = world_from_camera.inverse() @ BOARD
            error = np.array(self.wrong_by) if self.wrong else np.zeros(3)
            self.wrong = max(0, self.wrong - 1)
            range_m = float(np.linalg.norm(camera_from_target.translation))
            sigma_m = SIGMA_M + SIGMA_PER_M * range_m
            seen = camera_from_target @ pose(
                sigma_m * self.rng.normal(size=3) + error, SIGMA_RAD * self.rng.normal(size=3)
            )
            measurement = measure(
                odometry @ AIRFRAME.body_from_camera,
                seen,
                np.diag([sigma_m**2] * 3 + [SIGMA_RAD**2] * 3),
                self.now_ns,
                epoch=self.epoch,
            )
            self.in_flight.append((self.tick + ANSWER_TICKS, measurement))
        while self.in_flight and self.in_flight[0][0] <= self.tick:
            _, measurement = self.in_flight.pop(0)
            if self.link and measurement.epoch == self.epoch:
                self.estimate, _ = update(self.estimate, measurement)
                self.jumped = False

    def _move(self, velocity_command: np.ndarray, yaw_rate_command: float) -> None:
        """The vehicle follows with a lag; the arm on the board pushes it back."""
        arm = self.settings.mission.contact.arm
        steps = 4
        dt = TICK_S / steps
        before = float(self.tip[0])
        for _ in range(steps):
            acceleration = (velocity_command - self.velocity) / LAG_S
            if before < 0.0:
                acceleration = acceleration + OUT_WORLD * (arm.force_n(self.arm) / MASS_KG)
            self.velocity = self.velocity + dt * acceleration
            self.yaw_rate += dt / LAG_S * (yaw_rate_command - self.yaw_rate)
            self.body = self.body + dt * self.velocity
            self.yaw += dt * self.yaw_rate
            after = float(self.tip[0])
            closing = (before - after) / dt
            self.arm = arm.touched(self.arm, Base(-after, closing, 0.0), dt)
            if before > 0.0 >= after:
                self.closing.append(closing)
            before = after
