"""A simulation that goes on as a clock does; the clock of these tests is moved by hand."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from contact_sim.flight.autopilot import SimulatedVehicle
from contact_sim.flight.live import LATE_NS, TURN_STEPS, LiveSimulation
from contact_sim.flight.odometry import SimulatedOdometry
from contact_sim.simulation import STEP_NS, SimulationSettings
from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.offboard_rules import HOLD, OFFBOARD
from rgbd_wire.clock import ManualClock
from tests.unit.contact_sim.flights import PERFECT, simulation

MS = 1_000_000
TURN_NS = TURN_STEPS * STEP_NS


class Stage:
    """A live simulation on a clock that the test moves; every move waits until it has caught up."""

    def __init__(self, settings: SimulationSettings = PERFECT) -> None:
        self.clock = ManualClock(10**12)
        self.turned = threading.Condition()
        self.simulation = simulation(settings=settings)
        self.live = LiveSimulation(self.simulation, self.clock, self._on_turn)
        self.vehicle = SimulatedVehicle(self.live, self.clock)
        self.odometry = SimulatedOdometry(self.live)
        self.stamps: list[int] = []
        self.live.start()

    def _on_turn(self, sim, now_ns: int) -> None:
        with self.turned:
            self.stamps.append(now_ns)
            self.turned.notify_all()

    def pass_ms(self, ms: int) -> None:
        """A turn at a time, as it is in flight."""
        for _ in range(ms * MS // TURN_NS):
            seen = len(self.stamps)
            self.clock.advance(TURN_NS)
            with self.turned:
                assert self.turned.wait_for(lambda n=seen: len(self.stamps) > n, 10.0)

    def command(self, velocity=(0.0, 0.0, 0.0), yaw_rate: float = 0.0) -> None:
        self.vehicle.command(VelocityCommand(np.array(velocity), yaw_rate, self.clock.now_ns()))


@pytest.fixture
def stage():
    """Hovers, in its pilot's mode."""
    stage = Stage()
    yield stage
    stage.live.stop()
    assert "simulation" not in {t.name for t in threading.enumerate()}


def test_time_passes_as_the_clock_does(stage: Stage) -> None:
    """Every turn is stamped with the drone's clock, and none is left out."""
    stage.pass_ms(100)
    assert np.diff(stage.stamps).tolist() == [TURN_NS] * (len(stage.stamps) - 1)
    assert stage.stamps[-1] == stage.clock.now_ns()
    assert stage.live.slipped_ns == 0


def test_what_cannot_be_made_up_for_slips(stage: Stage) -> None:
    """A pause of a second: a quarter of it is caught up, the rest never was, and is told."""
    stage.pass_ms(20)
    before_ns = stage.simulation.t_ns
    stage.clock.advance(1_000 * MS)
    with stage.turned:
        caught_up_ns = stage.clock.now_ns() - TURN_NS
        assert stage.turned.wait_for(lambda: stage.stamps[-1] > caught_up_ns, 10.0)
    assert stage.simulation.t_ns - before_ns == pytest.approx(LATE_NS, abs=TURN_NS)
    assert stage.live.slipped_ns == pytest.approx(1_000 * MS - LATE_NS, abs=TURN_NS)


def test_commands_are_flown_in_their_mode_and_their_loss_is_noticed(stage: Stage) -> None:
    """In POSCTL they are air; engaged they are flown; without them the vehicle stops by itself."""
    for _ in range(25):
        stage.command((0.5, 0.0, 0.0))
        stage.pass_ms(20)
    assert abs(stage.vehicle.state().velocity_world[0]) < 0.05
    stage.vehicle.engage()
    for _ in range(50):
        stage.command((0.5, 0.0, 0.0))
        stage.pass_ms(20)
    state = stage.vehicle.state()
    assert state.obeying
    assert state.velocity_world[0] == pytest.approx(0.5, abs=0.1)
    assert state.t_pose_ns == pytest.approx(stage.clock.now_ns(), abs=20 * MS)
    stage.pass_ms(2000)
    state = stage.vehicle.state()
    assert (state.mode, state.failsafe, state.obeying) == (HOLD, "no setpoints", False)
    assert abs(state.velocity_world[0]) < 0.1


def test_it_is_engaged_and_given_back(stage: Stage) -> None:
    """The contract that all vehicles share."""
    assert stage.vehicle.idle
    stage.vehicle.engage()
    assert (stage.vehicle.idle, stage.vehicle.state().mode) == (False, OFFBOARD)
    stage.vehicle.release()
    assert (stage.vehicle.idle, stage.vehicle.state().mode) == (True, HOLD)
    assert HOLD in stage.vehicle.reason


def test_samples_are_stamped_with_the_drones_clock(stage: Stage) -> None:
    """VIO and lidars: not older than their delays, never from the future."""
    stage.pass_ms(200)
    now_ns = stage.clock.now_ns()
    for sample in (stage.odometry.odometry(), stage.odometry.height(), stage.odometry.ahead()):
        assert sample is not None
        assert 0 <= now_ns - sample.t_ns < 60 * MS


def test_what_the_client_passes_on_is_what_the_estimator_hears() -> None:
    """Fed by nobody it has no place after some seconds; fed with the VIO it keeps it."""
    settings = SimulationSettings(imu=PERFECT.imu, vio=PERFECT.vio, feeds_itself=False)
    for feeds in (False, True):
        stage = Stage(settings)
        try:
            for _ in range(300):
                stage.pass_ms(20)
                if feeds:
                    stage.vehicle.give_odometry(stage.odometry.odometry())
                    stage.vehicle.give_range(stage.odometry.height())
            assert (stage.vehicle.state().world_from_body is not None) == feeds
        finally:
            stage.live.stop()


def test_a_fault_of_the_physics_is_a_vehicle_that_falls_silent(stage: Stage) -> None:
    """No exception reaches the client: the last heartbeat grows old, and the reason is kept."""
    stage.pass_ms(20)
    with stage.live.look() as (sim, _):
        sim._data.qvel[:] = np.nan
    heard_ns = stage.vehicle.state().t_heard_ns
    stage.clock.advance(100 * MS)
    stage.live._thread.join(10.0)
    assert stage.live.error is not None
    stage.clock.advance(5_000 * MS)
    assert stage.vehicle.state().t_heard_ns == heard_ns
