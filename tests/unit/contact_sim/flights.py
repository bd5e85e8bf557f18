"""A plain world to fly the simulated vehicle in, and the real client's brain as its pilot."""

from __future__ import annotations

import mujoco
import numpy as np

from contact_sim.chance import stream
from contact_sim.lockstep.eyes import EyesSettings, ModelEyes
from contact_sim.lockstep.flight import LockstepFlight, LockstepSettings
from contact_sim.scene import Light, Scene
from contact_sim.sensing import d455
from contact_sim.sensing.imu import ImuSettings
from contact_sim.sensing.vio import VioSettings
from contact_sim.simulation import Simulation, SimulationSettings, Truth
from drone_client.airframe import Airframe
from drone_client.autopilot import VehicleState
from drone_client.control import ControlSettings, OnMission, decide
from drone_client.mission import MissionSettings, Phase, Senses, Transition, begin
from drone_client.target import TargetEstimate, TargetMeasurement, measure, update
from link_emulator.profiles import PROFILES, Profile
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import pose

AIRFRAME = Airframe()
_EYE = CameraIntrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
RIG = RgbdCamera(_EYE, _EYE, 0.001, pose((-0.059, 0.0, 0.0)))
BOARD_X_M, HEIGHT_M = 3.0, 1.5
BOARD = pose((BOARD_X_M, 0.0, HEIGHT_M), (0.0, 0.0, np.pi))
REACH_M = float(AIRFRAME.body_from_tip.translation[0])
PERFECT = SimulationSettings(
    imu=ImuSettings(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    vio=VioSettings(
        scale=0.0,
        walk_per_root_m=0.0,
        walk_per_root_s=0.0,
        yaw_walk=0.0,
        yaw_drift_radps=0.0,
        position_noise_m=0.0,
        velocity_noise_mps=0.0,
        attitude_noise_rad=0.0,
    ),
)
"""Sensors that are right."""
SECOND_STEPS = 500
"""Physics steps in a second."""
TICK_STEPS = 10
ANSWER_TICKS, FRAME_TICKS = 6, 5
SIGMA_M, SIGMA_PER_M, SIGMA_RAD = 0.0003, 0.001, 0.005
"""Of a measured place, beside that per metre of range, and of a measured attitude."""


def plain_world() -> mujoco.MjSpec:
    """A floor, and a wall two metres wide and high."""
    spec = mujoco.MjSpec()
    world = spec.worldbody
    world.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(20.0, 20.0, 0.1))
    world.add_geom(
        name="board",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.01, 1.0, 1.0),
        pos=(BOARD_X_M + 0.01, 0.0, HEIGHT_M),
    )
    return spec


def plain_scene(start=(0.0, 0.0, HEIGHT_M), turned_rad: float = 0.0) -> Scene:
    """The drone in front of the wall, which it faces but for an angle."""
    light = Light(1.0, 0.0, (0.0, 0.0, 0.0), 0.0, 1.0)
    at = pose(start, (0.0, 0.0, turned_rad))
    return Scene(plain_world(), "plain", 0, BOARD, at, 0.0, None, ("lamp",), light, {})


def simulation(
    seed: int = 0,
    settings: SimulationSettings | None = None,
    start=(0.0, 0.0, HEIGHT_M),
    turned_rad: float = 0.0,
) -> Simulation:
    """A flight in the plain world."""
    return Simulation(plain_scene(start, turned_rad), AIRFRAME, RIG, seed, settings)


def lockstep_flight(
    seed: int = 0,
    link: Profile = PROFILES["wifi"],
    settings: LockstepSettings | None = None,
    eyes: EyesSettings | None = None,
) -> LockstepFlight:
    """The client with model eyes, 1.2 m before touching the wall, aside and askew."""
    rig = d455()
    return LockstepFlight(
        plain_scene((BOARD_X_M - REACH_M - 1.2, 0.1, HEIGHT_M), 0.1),
        seed,
        link,
        lambda simulation: ModelEyes(rig.color, stream(seed, "eyes"), eyes),
        rig,
        settings,
    )


class Pilot:
    """Target filter, mission, guidance and safety filter of the client at 50 Hz, without a camera.

    What a worker would answer is the true pose of the board with the noise of a good localiser,
    120 ms late.
    """

    def __init__(self, sim: Simulation, seed: int = 0, **mission: float) -> None:
        self.sim = sim
        self.transitions: list[Transition] = []
        self.first_touch: Truth | None = None
        self.touching_s = 0.0
        self.mission = begin(0)
        self._rng = np.random.default_rng(seed)
        self._settings = ControlSettings(
            mission=MissionSettings(**mission), keep_outs=AIRFRAME.keep_outs
        )
        self._estimate: TargetEstimate | None = None
        self._in_flight: list[tuple[int, TargetMeasurement]] = []
        self._tick = 0

    def fly(self, seconds: float) -> Pilot:
        """So long, or until the mission has ended."""
        for _ in range(round(50 * seconds)):
            self._step()
            if self.mission.phase.final:
                break
        return self

    @property
    def phases(self) -> list[Phase]:
        return [transition.after for transition in self.transitions]

    def _step(self) -> None:
        sim, now_ns = self.sim, self.sim.t_ns
        believed = sim.estimate
        self._look(believed.world_from_body)
        vehicle = VehicleState(
            now_ns, "OFFBOARD", armed=True, obeying=True, battery_fraction=0.8, landed=False
        )
        decision = decide(
            now_ns,
            self._estimate,
            believed.world_from_body,
            AIRFRAME,
            self._settings,
            OnMission(self.mission, Senses(vehicle=vehicle)),
        )
        assert decision.mission is not None
        self.mission = decision.mission
        if self.mission.transition is not None:
            self.transitions.append(self.mission.transition)
        command = decision.command
        sim.set_velocity(command.velocity_world, command.yaw_rate_radps)
        sim.step(TICK_STEPS)
        self._tick += 1
        truth = sim.truth
        if truth.tip_force_n > 0.0:
            self.first_touch = self.first_touch or truth
            self.touching_s += 0.02

    def _look(self, believed: Pose) -> None:
        """A frame, if it is time for one; and the answers that are due."""
        if self._tick % FRAME_TICKS == 0:
            world_from_camera = self.sim.truth.world_from_body @ AIRFRAME.body_from_camera
            camera_from_target = world_from_camera.inverse() @ BOARD
            sigma_m = SIGMA_M + SIGMA_PER_M * float(np.linalg.norm(camera_from_target.translation))
            seen = camera_from_target @ pose(
                sigma_m * self._rng.normal(size=3), SIGMA_RAD * self._rng.normal(size=3)
            )
            measurement = measure(
                believed @ AIRFRAME.body_from_camera,
                seen,
                np.diag([sigma_m**2] * 3 + [SIGMA_RAD**2] * 3),
                self.sim.t_ns,
            )
            self._in_flight.append((self._tick + ANSWER_TICKS, measurement))
        while self._in_flight and self._in_flight[0][0] <= self._tick:
            self._estimate, _ = update(self._estimate, self._in_flight.pop(0)[1])
