"""A simulation in real time, in the hands of an autopilot outside; the clock is moved by hand."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import common as mav

from contact_sim.errors import PeerGoneError
from contact_sim.flight.odometry import SimulatedOdometry
from contact_sim.hil.flight import HilFlight, HilSettings
from contact_sim.hil.live import ASIDE_NS, HilLive
from contact_sim.hil.lockstep import Lockstep, Patience
from contact_sim.scene.drone import MASS_KG
from contact_sim.simulation import Simulation, SimulationSettings
from contact_sim.vehicle.rotors import MAX_THRUST_N
from rgbd_wire.clock import ManualClock
from tests.unit.contact_sim.flights import simulation

MS = 1_000_000
HOVER = MASS_KG * 9.81 / (4 * MAX_THRUST_N)


class Held:
    """A line to an armed PX4 whose answers the test lets out, one by one or all."""

    def __init__(self) -> None:
        self.asked = threading.Semaphore(0)
        self.may_answer = threading.Semaphore(0)
        self.gone = False
        self._ears, self._mouth = mav.MAVLink(None), mav.MAVLink(None, 1, 1)
        self._stamp = 0

    def send(self, data: bytes) -> None:
        self._stamp = self._ears.parse_buffer(data)[-1].time_usec
        self.asked.release()

    def receive(self, _timeout_s: float) -> bytes:
        assert self.may_answer.acquire(timeout=10.0)
        if self.gone:
            raise PeerGoneError("the peer closed the connection")
        controls = mav.MAVLink_hil_actuator_controls_message(self._stamp, [HOVER] * 16, 128, 1)
        return bytes(controls.pack(self._mouth))


class Stage:
    def __init__(self) -> None:
        self.clock, self.line = ManualClock(10**12), Held()
        self.seen: list[tuple[int, int]] = []
        self.turned = threading.Condition()
        self.aside = 0
        sim = simulation(settings=SimulationSettings(rotors_from_outside=True))
        lockstep = Lockstep(self.line, Patience(), self.clock)
        self.live = HilLive(
            HilFlight(sim, lockstep, 0, HilSettings(vio=False)),
            self.clock,
            self._on_turn,
            self._on_aside,
        )
        self.live.start()

    def _on_turn(self, sim: Simulation, now_ns: int) -> None:
        with self.turned:
            self.seen.append((sim.t_ns, now_ns))
            self.turned.notify_all()

    def _on_aside(self) -> None:
        # whoever looks into the simulation does not wait for this either
        with self.live.look():
            self.aside += 1

    def until(self, at_ms: int) -> None:
        with self.turned:
            at = at_ms * MS
            assert self.turned.wait_for(lambda: self.seen and self.seen[-1][0] >= at, 30.0)

    def end(self) -> None:
        self.line.gone = True
        self.line.may_answer.release()
        self.clock.advance(100 * MS)
        self.live._thread.join(10.0)
        assert not self.live._thread.is_alive()


@pytest.fixture
def stage() -> Iterator[Stage]:
    stage = Stage()
    yield stage
    stage.end()


def test_nobody_else_waits_for_an_answer(stage: Stage) -> None:
    """While PX4 thinks, camera, VIO and truth can be read; time stands still for them."""
    stage.clock.advance(12 * MS)
    assert stage.line.asked.acquire(timeout=10.0)
    with stage.live.look() as (sim, offset_ns):
        assert (sim.t_ns, offset_ns) == (4 * MS, 10**12)
    snapshot, _ = stage.live.snapshot()
    assert snapshot.t_ns == 4 * MS
    assert SimulatedOdometry(stage.live).odometry() is None
    stage.line.may_answer.release()
    assert stage.line.asked.acquire(timeout=10.0)
    assert stage.seen == [(4 * MS, 10**12 + 4 * MS), (8 * MS, 10**12 + 8 * MS)]


def test_a_pause_is_made_up_for(stage: Stage) -> None:
    """A second in which the machine did something else: no slip, for PX4's clock would slip too."""
    stage.line.may_answer.release(1000)
    stage.clock.advance(1000 * MS)
    with stage.turned:
        assert stage.turned.wait_for(lambda: stage.seen and stage.seen[-1][0] >= 996 * MS, 30.0)
    assert stage.live.slipped_ns == 0
    assert stage.seen[-1][1] <= stage.clock.now_ns()


def test_what_is_done_beside_is_done_every_half_a_second(stage: Stage) -> None:
    """At the first turn, and then by the clock of the machine, however many turns lie between."""
    stage.line.may_answer.release(10_000)
    stage.clock.advance(100 * MS)
    stage.until(96)
    assert stage.aside == 1
    stage.clock.advance(ASIDE_NS - MS)
    stage.until(596)
    assert stage.aside == 1
    stage.clock.advance(9 * MS)
    stage.until(604)
    assert stage.aside == 2


def test_who_goes_is_an_error_that_is_kept(stage: Stage) -> None:
    """The world stands still, and says why."""
    stage.clock.advance(12 * MS)
    assert stage.line.asked.acquire(timeout=10.0)
    stage.line.gone = True
    stage.line.may_answer.release()
    stage.live._thread.join(10.0)
    assert "closed the connection" in str(stage.live.error)
    stage.clock.advance(1000 * MS)
    assert stage.live.snapshot()[0].t_ns == 4 * MS
