"""One flight in lockstep: the client's own parts, a worker, a link and a world, tick by tick.

Departure clock, rate control, gate, target filter, mission, guidance, safety filter, jump watch,
odometry feed and dead man are the code of ``drone-client fly``, asked in the order in which they
would be. There is one worker: nothing is handed over and no probe is sent. Nothing here asks a
clock or draws a number that the seed does not fix.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_sim.chance import stream
from contact_sim.flight.outcome import Outcome, Row, Witness
from contact_sim.flight.search import searching
from contact_sim.lockstep.eyes import Eyes
from contact_sim.lockstep.link_model import LinkModel
from contact_sim.lockstep.sender import Exposed, Sender
from contact_sim.lockstep.vehicle import LockstepVehicle
from contact_sim.lockstep.worker import NAME, RemoteWorker, WorkerSettings
from contact_sim.scene import Scene
from contact_sim.sensing.rgbd import RgbdModel
from contact_sim.simulation import STEP_NS, Simulation, SimulationSettings
from drone_client.airframe import Airframe
from drone_client.control import Decision, OnMission, decide
from drone_client.flight_settings import FlightSettings, flight_settings
from drone_client.fly.vehicle_pose import VehiclePose
from drone_client.mission import MissionState, Order, Phase, Reason, Senses, Transition, begin
from drone_client.odometry.feed import OdometryFeed
from drone_client.odometry.jump import Jump
from drone_client.reception import Receiver, Reception
from drone_client.settings import default_settings
from drone_client.source.frozen import FrozenWatch
from link_emulator.profiles import Profile
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose

DRONE: Final = "drone"
BOOT_ID: Final = 1
TICK_NS: Final = 20_000_000
TURN_STEPS: Final = 2
CAMERA_HZ: Final = 15.0
LONGEST_S: Final = 360.0
"""Longer than a mission lets itself take, with its way back."""
ARRIVAL_NS: Final = 85_000_000
"""Of an answer after its exposure, about: for the ablation that composes it with the pose then."""
WARM_NS: Final = 500_000_000
"""The vehicle hovers for so long before a person says GO."""


@dataclass(frozen=True, slots=True)
class LockstepSettings:
    """Everything but the world and the seed."""

    parts: FlightSettings = field(
        default_factory=lambda: searching(flight_settings(default_settings()))
    )
    simulation: SimulationSettings = field(
        default_factory=lambda: SimulationSettings(feeds_itself=False)
    )
    worker: WorkerSettings = field(default_factory=WorkerSettings)
    camera_hz: float = CAMERA_HZ
    longest_s: float = LONGEST_S
    composes_now: bool = False
    """Ablation: a result is composed with where the drone is as it arrives, not with where it was
    at the exposure."""
    gates: bool = True
    """Ablation: False lets every result through, however late."""


@dataclass(frozen=True, slots=True, eq=False)
class Tick:
    """What the client believed and wanted at a control tick."""

    t_ns: int
    decision: Decision
    network_delay_ns: int | None
    """d1 + d2 of the newest result."""


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A flight that is over."""

    outcome: Outcome
    phase: Phase
    reason: Reason
    given_back: bool
    """The mission has ended; else time was up."""
    attempts: int
    transitions: tuple[Transition, ...]
    verdicts: dict[str, int]
    """Of the gate."""
    updates: dict[str, int]
    """Of the target filter."""
    counts: dict[str, int]
    """What became of frames."""
    rows: tuple[Row, ...]
    """The truth, 50 times a second."""
    ticks: tuple[Tick, ...]


class LockstepFlight:
    """A flight that is stepped; ``fly`` steps it to its end.

    Faults are switched between two ticks: ``worker``, ``link``, ``simulation`` and ``eyes`` take
    them.
    """

    def __init__(
        self,
        scene: Scene,
        seed: int,
        profile: Profile,
        open_eyes: Callable[[Simulation], Eyes],
        rig: RgbdCamera,
        settings: LockstepSettings | None = None,
        airframe: Airframe | None = None,
    ) -> None:
        """Put everything in its place; nothing has moved yet.

        Args:
            scene: the world.
            seed: of chance in flight.
            profile: of the link.
            open_eyes: who looks at the frames.
            rig: the cameras.
            settings: of all parts; keep-outs for floor and ceiling are added.
            airframe: of the drone.
        """
        self.settings = settings or LockstepSettings()
        self.airframe = airframe or Airframe()
        self.scene = scene
        self.simulation = Simulation(scene, self.airframe, rig, seed, self.settings.simulation)
        self.vehicle = LockstepVehicle(self.simulation)
        self.eyes = open_eyes(self.simulation)
        self.link = LinkModel(profile, stream(seed, "link"))
        self.frozen = False
        """The camera gives the same picture again and again, with new stamps."""
        self.witness = Witness(scene.world_from_target)
        self.ticks: list[Tick] = []
        self.transitions: list[Transition] = []
        self.receptions: list[Reception] = []
        """Every result that came in, with the gate's verdict."""
        self.mission: MissionState = begin(0)
        self._rig = rig
        planes = self.airframe.planes(scene.floor_m, scene.ceiling_m)
        self._control = replace(self.settings.parts.control, keep_outs=planes)
        gate = self.settings.parts.gate
        if not self.settings.gates:
            gate = replace(gate, tau_max_ns=10**11, age_max_ns=10**11)
        self._receiver = Receiver(
            DRONE,
            BOOT_ID,
            gate,
            self.airframe,
            on_heard=lambda sequence, worker, t_ns: self.sender.heard(sequence, t_ns),
            on_result=self._on_result,
            budget=self.settings.parts.odometry.budget,
        )
        self.sender = Sender(
            self.settings.parts.uplink,
            self.settings.parts.rate,
            lambda: self._receiver.estimate,
            round(1e6 * (profile.up.delay_ms + profile.down.delay_ms)),
        )
        self.worker = RemoteWorker(
            self.eyes,
            self.link,
            self._receiver,
            DRONE,
            BOOT_ID,
            stream(seed, "worker"),
            self.settings.worker,
        )
        believed = self.settings.parts.odometry
        self._pose = VehiclePose(self.vehicle.state, self._keep_pose, self._on_jump, believed.jump)
        self._feed = OdometryFeed(
            self.vehicle, self.vehicle, self._on_jump, believed.vio_jump, believed.lidar
        )
        self._camera_due_ns = 0
        self._camera: RgbdModel | None = None
        if self.eyes.needs_pictures:
            self._camera = RgbdModel(self.simulation.model, rig, scene.light, seed)
        self._given_back = False
        self._frozen_watch = FrozenWatch()
        self._noise = stream(seed, "noise of the sensor")
        self._black = np.zeros((rig.color.height, rig.color.width, 3), np.uint8)
        self._last: tuple[RgbdFrame, NDArray[np.uint8]] | None = None

    @property
    def phase(self) -> Phase:
        """Of the mission."""
        return self.mission.phase

    @property
    def tip_distance_m(self) -> float | None:
        """Of the tip from the board as the client believes; None: it knows of none."""
        tip = self.ticks[-1].decision.tip_target if self.ticks else None
        return None if tip is None else tip[0]

    @property
    def over(self) -> bool:
        """The vehicle was given back, or time is up."""
        return self._given_back or self.simulation.t_ns >= self.settings.longest_s * 1e9

    def fly(self, before_tick: Callable[[LockstepFlight], None] = lambda flight: None) -> Flown:
        """To the end.

        Args:
            before_tick: called before every tick; for faults.
        """
        try:
            while not self.over:
                before_tick(self)
                self.tick()
            return self.flown()
        finally:
            self.close()

    def tick(self) -> None:
        """20 ms: answers that arrived, a picture if one is due, a decision, and the flight on."""
        now_ns = self.simulation.t_ns
        if now_ns == WARM_NS:
            self.vehicle.rules.engage(now_ns)
        self.worker.deliver(now_ns)
        world_from_body = self._pose(now_ns)
        if now_ns >= self._camera_due_ns:
            self._camera_due_ns += round(1e9 / self.settings.camera_hz)
            self._expose(now_ns)
        leaving = self.sender.next(now_ns)
        if leaving is not None:
            sequence, sizes = self.worker.send(leaving)
            self.sender.sent(sequence, leaving, sizes, NAME)
        self._decide(now_ns, world_from_body)
        for _ in range(TICK_NS // (TURN_STEPS * STEP_NS)):
            self.vehicle.turn(TURN_STEPS)
            self.witness.look(self.simulation)

    def flown(self) -> Flown:
        """What it came to."""
        return Flown(
            self.witness.outcome(self.simulation, TURN_STEPS * STEP_NS / 1e9),
            self.mission.phase,
            self.mission.reason,
            self._given_back,
            self.mission.attempts,
            tuple(self.transitions),
            dict(Counter(r.judgement.verdict.value for r in self.receptions)),
            dict(Counter(r.update.value for r in self.receptions if r.update is not None)),
            dict(self.worker.counts + self.sender.counts),
            tuple(self.witness.rows),
            tuple(self.ticks),
        )

    def close(self) -> None:
        """Give the renderer back."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _expose(self, now_ns: int) -> None:
        truth = self.simulation.truth.world_from_body @ self.airframe.body_from_camera
        camera_from_target = truth.inverse() @ self.scene.world_from_target
        frame = self._take(now_ns)
        # Without pictures a few numbers of noise stand for one: they differ as exposures do
        seen = self._noise.integers(0, 255, (4, 4, 3), np.uint8)
        if self._camera is not None:
            seen = frame.color_rgb
        if self.frozen and self._last is not None:
            last, seen = self._last
            frame = replace(last, t_capture_ns=now_ns, world_from_camera=frame.world_from_camera)
        self._last = frame, seen
        if self._frozen_watch.see(seen):
            self.worker.counts["frozen"] += 1
            return
        self.sender.submit(Exposed(frame, camera_from_target))

    def _take(self, now_ns: int) -> RgbdFrame:
        """What the camera gives; black where nobody looks."""
        color_rgb, depth_units = self._black, None
        if self._camera is not None:
            picture = self._camera.take(self.simulation.snapshot())
            color_rgb, depth_units = picture.color_rgb, picture.depth_units
        return RgbdFrame(color_rgb, depth_units, self._rig, now_ns, self._camera_at(now_ns))

    def _keep_pose(self, t_ns: int, world_from_body: Pose) -> None:
        late_ns = ARRIVAL_NS if self.settings.composes_now else 0
        self._receiver.add_pose(t_ns - late_ns, world_from_body)

    def _camera_at(self, now_ns: int) -> Pose | None:
        world_from_body = self._receiver.pose_at(now_ns)
        return None if world_from_body is None else world_from_body @ self.airframe.body_from_camera

    def _decide(self, now_ns: int, world_from_body: Pose | None) -> None:
        forward_m = self._feed.tick(now_ns)
        silent = self._feed.silent(now_ns)
        jumped = self._pose.jumped(now_ns) or self._receiver.lost is not None
        order = Order.GO if now_ns >= WARM_NS else Order.HOLD
        senses = Senses(
            self.vehicle.state(),
            odometry_silent=silent,
            odometry_jumped=jumped,
            forward_m=forward_m,
            order=order,
        )
        decision = decide(
            now_ns,
            self._receiver.estimate,
            world_from_body,
            self.airframe,
            self._control,
            OnMission(self.mission, senses),
        )
        self.vehicle.command(decision.command)
        assert decision.mission is not None
        self.mission = decision.mission
        if self.mission.transition is not None:
            self.transitions.append(self.mission.transition)
        newest = self.receptions[-1].judgement.network_delay_ns if self.receptions else None
        self.ticks.append(Tick(now_ns, decision, newest))
        if decision.intent is not None and decision.intent.give_back:
            self.vehicle.rules.release()
            self._given_back = True

    def _on_result(self, reception: Reception) -> None:
        self.receptions.append(reception)
        self.worker.counts[reception.result.outcome.value] += 1

    def _on_jump(self, jump: Jump) -> None:
        self._receiver.begin_epoch(jump.t_ns)
