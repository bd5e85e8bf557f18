"""The client's own autopilot flies a PX4 outside, which flies the simulated drone.

The stand-in is one process with PX4's two lines: its simulator's and its client's.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from contact_sim.errors import HilError
from contact_sim.flight.live import LiveSimulation
from contact_sim.flight.odometry import SimulatedOdometry
from contact_sim.hil.outside import Outside
from contact_sim.simulation import Truth
from drone_client.autopilot import VelocityCommand
from drone_client.errors import AutopilotError
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
        return json.loads(said)

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
    before = flight.truth()
    flight.until(flight.after(3.0), "it flies", velocity=(0.2, 0.3, 0.0))
    flown = flight.truth()
    way = flown.world_from_body.translation - before.world_from_body.translation
    assert way[:2] == pytest.approx([0.6, 0.9], abs=0.3)
    assert abs(way[2]) < 0.15
    assert flown.velocity_world[:2] == pytest.approx([0.2, 0.3], abs=0.12)

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
