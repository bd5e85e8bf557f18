"""The simulation in an autopilot's hands from outside: instruments, rotors, turns."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from contact_sim.errors import VehicleError
from contact_sim.hil.flight import TURN_NS, HilFlight, HilSettings
from contact_sim.hil.lockstep import Lockstep, Patience
from contact_sim.hil.motors import Controls
from contact_sim.scene.drone import MASS_KG
from contact_sim.simulation import SimulationSettings
from contact_sim.vehicle.rotors import MAX_THRUST_N
from rgbd_wire.clock import ManualClock
from tests.unit.contact_sim.flights import PERFECT, simulation

OUTSIDE = SimulationSettings(rotors_from_outside=True)
HOVER_N = MASS_KG * 9.81 / 4
HOVER = HOVER_N / MAX_THRUST_N


class Obedient:
    """A line to a PX4 that is armed and answers each question with the same controls."""

    def __init__(self, control: float) -> None:
        self.heard: list[mav.MAVLink_message] = []
        self._control = control
        self._ears, self._mouth = mav.MAVLink(None), mav.MAVLink(None, 1, 1)
        self._answer = b""

    def send(self, data: bytes) -> None:
        self.heard += self._ears.parse_buffer(data)
        controls = mav.MAVLink_hil_actuator_controls_message(
            self.heard[-1].time_usec, [self._control] * 16, 128, 1
        )
        self._answer = bytes(controls.pack(self._mouth))

    def receive(self, _timeout_s: float) -> bytes:
        answer, self._answer = self._answer, b""
        assert answer, "an answer was said, and not taken for one"
        return answer


def flight(line: Obedient, settings: SimulationSettings = OUTSIDE) -> HilFlight:
    exchange = Lockstep(line, Patience(), ManualClock())
    return HilFlight(simulation(settings=settings), exchange, 0, HilSettings())


def test_each_turn_is_a_question_about_now():
    """From the second one on: stamps are the simulated time at which the answer is flown."""
    line = Obedient(HOVER)
    flown = flight(line)
    for _ in range(5):
        flown.turn()
    assert flown.simulation.t_ns == 5 * TURN_NS
    stamps = [m.time_usec for m in line.heard if m.get_type() == "HIL_SENSOR"]
    assert stamps == [4000, 8000, 12_000, 16_000]
    assert flown.lockstep.counts == {"asked": 4, "answered": 4}
    assert flown.armed_turns == 4


def test_a_falling_drone_feels_nothing_and_a_hovering_one_its_weight():
    """The first sample is of free fall; once the rotors carry it, of g up: -9.81 in FRD."""
    line = Obedient(HOVER)
    perfect = SimulationSettings(imu=PERFECT.imu, vio=PERFECT.vio, rotors_from_outside=True)
    flown = flight(line, perfect)
    for _ in range(200):
        flown.turn()
    felt = [m.zacc for m in line.heard if m.get_type() == "HIL_SENSOR"]
    assert felt[0] == pytest.approx(0.0, abs=0.05)
    assert felt[-1] == pytest.approx(-9.81, abs=0.05)
    # the motors' lag of 40 ms
    assert felt[10] == pytest.approx(-9.81 * (1 - np.exp(-1.0)), abs=0.5)


def test_more_lift_climbs_and_none_falls():
    """The rotors do what was answered."""
    heights = []
    for control in (0.0, HOVER, 0.8):
        flown = flight(Obedient(control))
        for _ in range(100):
            flown.turn()
        heights.append(float(flown.simulation.truth.world_from_body.translation[2]))
    assert heights[0] < heights[1] < 1.5 < heights[2]
    assert heights[0] == pytest.approx(1.5 - 0.5 * 9.81 * 0.4**2, abs=0.02)


def test_what_was_said_last_is_flown_on_without_an_answer():
    """And until anything is said the rotors stand still."""
    flown = flight(Obedient(HOVER))
    flown.obey(None)
    assert flown.simulation.truth.velocity_world[2] == pytest.approx(-9.81 * 0.004, rel=0.05)
    flown.obey(Controls(4000, (1.0,) * 4, armed=True, lockstep=True))
    for _ in range(50):
        flown.obey(None)
    assert flown.simulation.truth.velocity_world[2] > 0.5
    flown.obey(Controls(8000, (1.0,) * 4, armed=False, lockstep=True))
    assert flown.armed_turns == 1


def test_a_flight_from_outside_is_the_same_every_time():
    """Bit for bit, noise and all."""
    ends = []
    for _ in range(2):
        flown = flight(Obedient(0.51))
        for _ in range(250):
            flown.turn()
        ends.append((flown.simulation.snapshot().qpos.tobytes(), flown.simulation.vio))
    assert ends[0][0] == ends[1][0]
    assert np.array_equal(
        ends[0][1].world_from_body.translation, ends[1][1].world_from_body.translation
    )


def test_reading_the_imu_does_not_change_the_flight():
    """Asked for or not, a sample is taken once."""
    asked, not_asked = (simulation(seed=5) for _ in range(2))
    for _ in range(100):
        first, second = asked.read_imu(), asked.read_imu()
        assert first is second
        asked.step(2)
        not_asked.step(2)
    assert np.array_equal(asked.snapshot().qpos, not_asked.snapshot().qpos)


def test_the_imu_is_read_between_turns_alone():
    """In the middle of one there is no sample."""
    sim = simulation(settings=OUTSIDE)
    assert sim.read_imu() is None
    sim.step(1)
    with pytest.raises(VehicleError, match="at every second step, not at 1"):
        sim.read_imu()


@pytest.mark.parametrize(
    "thrusts",
    [(1.0, 1.0, 1.0), (1.0, 1.0, 1.0, float("nan")), (-0.1, 1, 1, 1), (1, 1, 1, MAX_THRUST_N + 1)],
)
def test_what_is_no_thrust_is_refused(thrusts):
    """Four numbers within the rotors' range."""
    with pytest.raises(VehicleError, match="four thrusts from 0 to 16.5 N"):
        simulation(settings=OUTSIDE).set_rotors(thrusts)


def test_the_velocity_loop_keeps_its_rotors():
    """Who did not ask for them cannot turn them."""
    with pytest.raises(VehicleError, match="set rotors_from_outside"):
        simulation().set_rotors((1.0, 1.0, 1.0, 1.0))
