"""What is flown in: a world that runs, a service, the link between them."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import numpy as np

from contact_sim.errors import ServiceError, SimulatorError, VehicleError
from contact_sim.flight.autopilot import SimulatedVehicle
from contact_sim.flight.camera import SimulatedCamera
from contact_sim.flight.live import TURN_STEPS, LiveSimulation
from contact_sim.flight.odometry import SimulatedOdometry
from contact_sim.flight.outcome import MOUTH_M, Witness
from contact_sim.flight.search import searching
from contact_sim.flight.service import ServiceProcess, free_udp_port
from contact_sim.hil.line import address_of
from contact_sim.hil.outside import Outside
from contact_sim.recording.truth import TruthWriter
from contact_sim.scene import Scene, build_scene
from contact_sim.sensing import d455
from contact_sim.simulation import STEP_NS, Simulation, SimulationSettings
from drone_client.airframe import Airframe
from drone_client.autopilot import FlyingAutopilot
from drone_client.errors import WorldError
from drone_client.flight_settings import FlightSettings
from drone_client.fly.simulator import SimulatorRequest
from link_emulator.profiles import profile
from link_emulator.proxy_process import UdpProxy
from rgbd_wire.clock import Clock

CLEAR_M: Final = 0.3
"""Between the tip and the board at the start, at least, whichever way the drone looks."""


class SimulatedWorld:
    """A ``Simulator`` of the client's."""

    def __init__(
        self,
        scene: Scene,
        seed: int,
        clock: Clock,
        folder: Path,
        outside: Outside | None = None,
        airframe: Airframe | None = None,
        mouth_m: float = MOUTH_M,
    ) -> None:
        """Build the drone into a scene; ``start`` lets time pass.

        Args:
            scene: the world.
            seed: of all that is drawn by chance in flight.
            clock: the drone's.
            folder: of the run; how it truly was is written there from the run's beginning on.
            outside: a PX4 that is the vehicle, waited for here; None: the simulator's own.
            airframe: of the drone; None: the usual one.
            mouth_m: radius within which the tip may touch.

        Raises:
            VehicleError: the drone cannot be built so, or has no room where the flight begins.
        """
        rig, airframe = d455(), airframe or Airframe()
        self.scene = scene
        self.witness = Witness(scene.world_from_target, mouth_m)
        self.truth = TruthWriter(folder)
        self.outside = outside
        self.live: LiveSimulation
        self.vehicle: FlyingAutopilot
        if outside is None:
            # As on the real robot: the estimator hears of VIO and height through the client
            settings = SimulationSettings(feeds_itself=False)
            simulation = Simulation(scene, airframe, rig, seed, settings)
            _check_room(simulation)
            self.live = LiveSimulation(simulation, clock, self._look)
            self.vehicle = SimulatedVehicle(self.live, clock)
        else:
            self.live = outside.live(scene, airframe, rig, seed, self._look)
            self.vehicle = outside.vehicle
        self.camera = SimulatedCamera(
            self.live, rig, scene.light, seed, clock, on_start=self.truth.begin
        )
        self.odometry = SimulatedOdometry(self.live)
        self.reach: dict[str, Any] = {}
        self.stack = ExitStack()

    @property
    def floor_m(self) -> float:
        """Height of the floor."""
        return self.scene.floor_m

    @property
    def ceiling_m(self) -> float | None:
        """Height of the ceiling."""
        return self.scene.ceiling_m

    def tuned(self, parts: FlightSettings) -> FlightSettings:
        """With a search that turns."""
        return searching(parts)

    def start(self) -> None:
        """Let time pass."""
        self.live.start()
        self.stack.callback(self.truth.close)
        self.stack.callback(self.live.stop)
        if self.outside is not None:
            self.stack.callback(self.outside.close)  # given back while it still flies

    def report(self) -> dict[str, Any]:
        """What the flight truly came to, in which world."""
        with self.live.look() as (simulation, _):
            outcome = self.witness.outcome(simulation, TURN_STEPS * STEP_NS / 1e9)
        error = self.live.error
        return {
            "world": self.scene.name,
            "seed": self.scene.seed,
            "facts": dict(self.scene.facts),
            "slipped_s": self.live.slipped_ns / 1e9,
            "error": None if error is None else str(error),
            "unwritten": self.truth.problem(),
            **({} if self.outside is None else {"hil": self.outside.counts()}),
            **outcome.as_json(),
            "safe": outcome.safe,
        }

    def film(self, run: Path, path: Path, on_progress: Callable[[float], None]) -> None:
        """Let the world stand still, and draw the flight that is over into a video.

        Raises:
            WorldError: it cannot be drawn here, or not be written.
        """
        from contact_sim.recording.film import film  # what it draws with is slow to load

        self.live.stop()
        self.truth.close()
        try:
            film(run, self.scene, path, on_progress)
        except SimulatorError as error:
            raise WorldError(str(error)) from None

    def close(self) -> None:
        """End all of it."""
        self.stack.close()

    def _look(self, simulation: Simulation, now_ns: int) -> None:
        self.witness.look(simulation)
        self.truth.look(simulation, now_ns)


def open_world(request: SimulatorRequest, clock: Clock) -> SimulatedWorld:
    """The world of a request, running, with a service if it named none.

    Raises:
        SimulatorError: there is no such world, board or seed, no drone of that airframe, or no
            service came up.
        EmulatorError: there is no such link.
    """
    link = None if request.link is None else profile(request.link)
    if link is not None and not request.starts_service:
        raise ServiceError(
            "--link lies before a service that is started for the flight: leave --connect, or "
            "DRONE_CONNECT, out"
        )
    scene = build_scene(request.world, request.seed, request.board)
    with contextlib.ExitStack() as undo:
        outside = None
        if request.hil is not None:
            outside = Outside(*address_of(request.hil), request.autopilot, clock)
            undo.callback(outside.close)
        world = SimulatedWorld(
            scene,
            request.seed,
            clock,
            request.folder,
            outside,
            request.airframe,
            request.mouth_m,
        )
        undo.callback(world.close)
        if request.starts_service:
            options: list[str] = []
            if link is not None:
                port = free_udp_port()
                keys = _write_key(request.folder, request.drone)
                world.stack.callback(keys.unlink, missing_ok=True)  # of this flight alone
                options = ["--udp", f"127.0.0.1:{port}", "--keys", str(keys)]
            service = world.stack.enter_context(ServiceProcess(request.folder, *options))
            # whatever the environment says of another one
            world.reach = {"connect": service.endpoint, "key_file": None, "tls": None}
            if link is not None:
                proxy = UdpProxy(("127.0.0.1", port), link.up, link.down, seed=request.seed)
                world.stack.enter_context(proxy)
                world.reach |= {"connect": f"udp/127.0.0.1:{proxy.port}", "key_file": keys}
        world.start()
        undo.pop_all()
    return world


def _check_room(simulation: Simulation) -> None:
    """An arm that could turn before the board, and a turn in the air in which nothing touches.

    Raises:
        VehicleError: the drone is too large for that.
    """
    scene = simulation.scene
    way = scene.world_from_target.translation - scene.world_from_body.translation
    away_m = float(np.linalg.norm(way))
    reach_m = float(np.linalg.norm(simulation.airframe.body_from_tip.translation))
    if reach_m + CLEAR_M > away_m:
        raise VehicleError(
            f"an arm that reaches {reach_m:.2f} m has no room where the flight begins: the board "
            f"is {away_m:.2f} m away"
        )
    simulation.step(TURN_STEPS)
    if touches := simulation.contacts.touches:
        raise VehicleError(
            f"a drone of this airframe has no room where the flight begins: {touches[0].part} is "
            f"on {touches[0].other}"
        )


def _write_key(folder: Path, drone: str) -> Path:
    """A key for the tunnel, for this flight alone."""
    path = folder / "tunnel.key"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        path.touch(mode=0o600)
        path.write_text(f"{drone} {secrets.token_hex(32)}\n", encoding="ascii")
    except OSError as error:
        raise ServiceError(f"cannot write {path}: {error.strerror}") from None
    return path
