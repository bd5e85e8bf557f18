"""The client's own autopilot flies a PX4 outside, which flies the simulated drone.

The stand-in is one process with PX4's two lines: its simulator's and its client's.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from contact_sim.errors import HilError
from contact_sim.flight.live import LiveSimulation
from contact_sim.flight.odometry import SimulatedOdometry
from contact_sim.hil.outside import Outside
from contact_sim.simulation import Truth
from drone_client.autopilot import VelocityCommand
from drone_client.errors import AutopilotError, WorldError
from drone_client.fly.simulator import SimulatorRequest, open_simulator
from drone_client.odometry.feed import OdometryFeed
from rgbd_wire.clock import MonotonicClock
from tests.service_process import free_udp_port
from tests.unit.contact_sim.flights import AIRFRAME, RIG, plain_scene

VEHICLE = Path(__file__).with_name("px4_hil_vehicle.py")
GIVE_UP_S = 60.0


class Flight:
    """World, stand-in, and the client's autopilot with its odometry feed."""

    def __init__(self) -> None:
        clock, port = MonotonicClock(), free_udp_port()
        self.clock = clock
        self.outside = Outside("127.0.0.1", 0, f"udp/127.0.0.1:{port}", clock)
        host, tcp = self.outside.address
        self.process = subprocess.Popen(
            [
                sys.executable,
                str(VEHICLE),
                "--connect",
                f"{host}:{tcp}",
                "--udp",
                f"127.0.0.1:{port}",
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        self.turns = 0
        self.live: LiveSimulation = self.outside.live(
            plain_scene(), AIRFRAME, RIG, 3, self._on_turn
        )
        self.vehicle = self.outside.vehicle
        self.feed = OdometryFeed(SimulatedOdometry(self.live), self.vehicle)
        self.live.start()

    def _on_turn(self, _simulation: object, _now_ns: int) -> None:
        self.turns += 1

    def truth(self) -> Truth:
        with self.live.look() as (simulation, _):
            return simulation.truth

    def until(
        self,
        condition: Callable[[], object],
        what: str,
        velocity: tuple[float, float, float] | None = None,
    ) -> None:
        """As the control loop does: feed the odometry, leave a command."""
        end = time.monotonic() + GIVE_UP_S
        while not condition():
            assert time.monotonic() < end, f"never: {what}"
            assert self.live.error is None, self.live.error
            self.feed.tick(self.clock.now_ns())
            if velocity is not None:
                command = VelocityCommand(np.array(velocity), 0.0, self.clock.now_ns())
                self.vehicle.command(command)
            time.sleep(0.01)

    def after(self, seconds: float) -> Callable[[], bool]:
        """So much simulated time from now."""
        end_ns = self.truth().t_ns + round(seconds * 1e9)
        return lambda: self.truth().t_ns >= end_ns

    def height_m(self) -> float:
        return float(self.truth().world_from_body.translation[2])

    def obeying(self) -> bool:
        state = self.vehicle.state()
        return state is not None and state.obeying

    def end(self) -> dict:
        """What the stand-in says of it."""
        self.outside.close()
        said, _ = self.process.communicate(timeout=GIVE_UP_S)
        return json.loads(said.splitlines()[-1])

    def close(self) -> None:
        self.outside.close()
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    yield flight
    flight.close()


def test_the_client_flies_a_px4_that_flies_the_simulation(flight: Flight) -> None:
    """From boot to OFFBOARD and back, by the lines of a real drone: the truth follows commands."""
    flight.until(lambda: flight.height_m() > 1.1, "it takes off by itself")
    flight.until(flight.after(3.0), "it hovers")
    state = flight.vehicle.state()
    assert state is not None
    assert state.armed
    assert not state.obeying
    # what it believes is where it is, in our axes
    at = flight.truth().world_from_body
    assert state.world_from_body is not None
    assert np.linalg.norm(state.world_from_body.translation - at.translation) < 0.2
    assert state.world_from_body.rotation[:, 0] @ at.rotation[:, 0] > 0.98

    flight.vehicle.engage()
    flight.until(flight.obeying, "OFFBOARD", velocity=(0.0, 0.0, 0.0))
    start = flight.truth().world_from_body.translation

    def way() -> np.ndarray:
        return flight.truth().world_from_body.translation - start

    flight.until(lambda: np.linalg.norm(way()) > 0.8, "it flies", velocity=(0.2, 0.3, 0.0))
    east, north, up = way()
    assert (east, north) == pytest.approx((0.8 * 0.555, 0.8 * 0.832), abs=0.15)
    assert abs(up) < 0.15

    flight.vehicle.release()
    flight.until(lambda: flight.vehicle.idle, "it is given back")
    report = flight.end()
    assert report["mode"] == "AUTO.LOITER"
    assert report["violations"] == []


def test_a_px4_that_dies_is_a_world_that_stands_still(flight: Flight) -> None:
    """The client hears no more heartbeats; the simulation says why it stands still."""
    flight.until(lambda: flight.turns > 100, "it runs")
    flight.process.kill()
    end = time.monotonic() + GIVE_UP_S
    while flight.live.error is None:
        assert time.monotonic() < end
        time.sleep(0.01)
    assert isinstance(flight.live.error, HilError)
    assert "the connection" in str(flight.live.error)
    turns = flight.turns
    time.sleep(0.05)
    assert flight.turns == turns


def test_the_simulator_of_the_client_opens_it(tmp_path: Path) -> None:
    """What ``drone-client fly --sim refinery --hil ...`` gets: a world whose vehicle is the PX4."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        at = f"127.0.0.1:{free.getsockname()[1]}"
    udp = f"127.0.0.1:{free_udp_port()}"
    request = SimulatorRequest(
        "refinery", 2, "clean", None, "drone", tmp_path, False, at, f"udp/{udp}"
    )
    process = subprocess.Popen(
        [sys.executable, str(VEHICLE), "--connect", at, "--udp", udp], stdout=subprocess.DEVNULL
    )
    try:
        world = open_simulator(request, MonotonicClock())
        try:
            end = time.monotonic() + GIVE_UP_S
            while world.report()["hil"].get("answered", 0) < 250 or world.vehicle.state() is None:
                assert time.monotonic() < end
                time.sleep(0.02)
            report, state = world.report(), world.vehicle.state()
        finally:
            world.close()
    finally:
        process.kill()
        process.wait()
    assert report["error"] is None
    assert state is not None
    assert state.mode == "POSCTL"


@pytest.mark.parametrize(
    ("hil", "words"), [("4560", "is no address to listen at"), ("192.0.2.1:1", "not an address of")]
)
def test_an_address_that_is_none_ends_the_command(hil: str, words: str, tmp_path: Path) -> None:
    """In one line, as whatever else a person types wrongly."""
    request = SimulatorRequest(
        "refinery", 2, "clean", None, "drone", tmp_path, False, hil, "udp/127.0.0.1:14540"
    )
    with pytest.raises(WorldError, match=words):
        open_simulator(request, MonotonicClock())


def test_a_px4_without_a_world_is_a_mistake() -> None:
    """--hil says how a simulated drone is flown, and not where."""
    ended = subprocess.run(
        [sys.executable, "-m", "drone_client.cli", "fly", "--hil", "127.0.0.1:4560"],
        capture_output=True,
        text=True,
        timeout=GIVE_UP_S,
        check=False,
    )
    assert ended.returncode == 2
    assert "which one? --sim says it" in ended.stderr


def closed_within(stranger: socket.socket, seconds: float) -> bool:
    stranger.settimeout(seconds)
    try:
        return stranger.recv(1) == b""
    except ConnectionResetError:
        return True
    except TimeoutError:
        return False


def test_a_second_px4_is_turned_away_and_counted() -> None:
    """Not left in the kernel's queue, in which it would hang; the first one's line stays open."""
    outside = Outside("127.0.0.1", 0, f"udp/127.0.0.1:{free_udp_port()}", MonotonicClock())
    with closing(outside), socket.create_connection(outside.address) as first:
        # who is in the queue already when the flight begins
        with socket.create_connection(outside.address) as early:
            assert outside.counts() == {}
            live = outside.live(plain_scene(), AIRFRAME, RIG, 3, lambda *_: None)
            assert "turned_away" not in outside.counts()
            live.start()
            assert closed_within(early, GIVE_UP_S)
        first.settimeout(GIVE_UP_S)
        assert first.recv(16), "it is asked"
        with socket.create_connection(outside.address) as late:
            assert closed_within(late, GIVE_UP_S)
        end = time.monotonic() + GIVE_UP_S
        while outside.counts().get("turned_away", 0) < 2:
            assert time.monotonic() < end
            time.sleep(0.01)
        assert outside.counts()["turned_away"] == 2
        assert live.error is None


def test_a_door_that_is_closed_ends_no_flight() -> None:
    """Nobody is turned away there, and the world goes on."""
    outside = Outside("127.0.0.1", 0, f"udp/127.0.0.1:{free_udp_port()}", MonotonicClock())
    with closing(outside), socket.create_connection(outside.address):
        turned = threading.Event()
        live = outside.live(plain_scene(), AIRFRAME, RIG, 3, lambda *_: turned.set())
        outside._door.close()
        live.start()
        assert turned.wait(GIVE_UP_S)
        assert live.error is None
        assert "turned_away" not in outside.counts()


def test_what_cannot_be_opened_leaves_nothing_open() -> None:
    """An address of an autopilot that is none: the port for its simulator is free again."""
    clock = MonotonicClock()
    with pytest.raises(AutopilotError, match="is no address"):
        Outside("127.0.0.1", 0, "nowhere", clock)
    outside = Outside("127.0.0.1", 0, f"udp/127.0.0.1:{free_udp_port()}", clock)
    with pytest.raises(HilError, match="the port is taken"):
        Outside("127.0.0.1", outside.address[1], "udp/127.0.0.1:1", clock)
    outside.close()
    again = Outside("127.0.0.1", outside.address[1], f"udp/127.0.0.1:{free_udp_port()}", clock)
    again.close()
    assert "autopilot-pacer" not in {thread.name for thread in threading.enumerate()}
