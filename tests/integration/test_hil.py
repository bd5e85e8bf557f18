"""A stand-in for PX4, a process of its own, flies the simulated drone over TCP in lockstep."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contact_sim.hil.flight import HilSettings
from contact_sim.hil.ground import on_the_ground
from contact_sim.hil.line import Door
from contact_sim.hil.lockstep import Patience
from contact_sim.hil.session import FlightReport, Session
from contact_sim.scene import Scene, build_scene
from contact_sim.simulation import Truth
from rgbd_wire.clock import MonotonicClock
from tests.unit.contact_sim.flights import plain_scene

PEER = Path(__file__).with_name("px4_hil_peer.py")
CLIMBED_S = 6.0
"""It arms after one second, and climbs for four."""
HOVER_S = 20.0
PATIENT = Patience(first_s=60.0, idle_s=60.0, armed_s=60.0)
"""However loaded the machine is, every answer is waited for: flights are the same every time."""
GIVE_UP_S = 60.0
SEED = 3


@dataclass
class Flown:
    """A flight, as it was seen from both ends."""

    report: FlightReport
    peer: dict[str, Any]
    """What the stand-in reports; empty: it had to be ended."""
    truths: list[Truth] = field(default_factory=list)

    @property
    def places(self) -> np.ndarray:
        return np.array([t.world_from_body.translation for t in self.truths])

    def after(self, seconds: float) -> list[Truth]:
        return [t for t in self.truths if t.t_ns > (seconds + 0.004) * 1e9]


@contextmanager
def stand_in(door: Door, *options: str) -> Iterator[subprocess.Popen[str]]:
    host, port = door.address
    process = subprocess.Popen(
        [sys.executable, str(PEER), "--connect", f"{host}:{port}", *options],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def fly_at(
    door: Door,
    *options: str,
    scene: Scene | None = None,
    waits: Patience = PATIENT,
    settings: HilSettings | None = None,
    speed: float = 0.0,
) -> Flown:
    """One flight of a stand-in that connects to this door."""
    truths: list[Truth] = []
    with stand_in(door, *options) as process:
        line = door.wait(GIVE_UP_S)
        assert line is not None, "the stand-in connects"
        with closing(line):
            session = Session(
                line,
                scene or on_the_ground(plain_scene()),
                SEED,
                settings or HilSettings(),
                waits,
                MonotonicClock(),
            )
            report = session.fly(speed, lambda s: truths.append(s.simulation.truth))
        try:
            said, _ = process.communicate(timeout=2.0 if report.failed else GIVE_UP_S)
        except subprocess.TimeoutExpired:
            said = "{}"
    return Flown(report, json.loads(said or "{}"), truths)


def fly(*options: str, **more: Any) -> Flown:
    with closing(Door("127.0.0.1", 0)) as door:
        return fly_at(door, *options, **more)


@pytest.fixture(scope="module")
def hover() -> Flown:
    """In a real world, from the ground up."""
    scene = on_the_ground(build_scene("tunnel", SEED))
    return fly("--seconds", str(CLIMBED_S + HOVER_S), scene=scene)


@pytest.fixture(scope="module")
def plain() -> Flown:
    """Eight seconds over a plain floor: what others are compared with."""
    return fly("--seconds", "8")


def test_it_takes_off_and_holds_its_place(hover: Flown) -> None:
    """Twenty simulated seconds within 20 cm of the place above its start, by the truth."""
    ground = hover.places[250]
    held = hover.after(CLIMBED_S)
    assert len(held) == 250 * HOVER_S
    off = np.array([t.world_from_body.translation for t in held]) - ground - (0.0, 0.0, 1.2)
    assert np.linalg.norm(off, axis=1).max() < 0.2
    # and quietly: it neither swings nor turns away
    assert max(math.acos(min(1.0, t.world_from_body.rotation[2, 2])) for t in held) < 0.06
    start, end = (t.world_from_body.rotation[:, 0] for t in (hover.truths[250], held[-1]))
    assert start @ end > math.cos(0.1)


def test_it_stands_on_the_ground_until_it_is_armed(hover: Flown) -> None:
    """For the first second the rotors stand still, and the drone does not move."""
    waiting = hover.places[50:250]
    assert np.abs(waiting - waiting[0]).max() < 1e-3
    assert hover.places[-1][2] - waiting[0][2] == pytest.approx(1.2, abs=0.2)
    assert hover.report.armed_s == pytest.approx(CLIMBED_S + HOVER_S - 1.0, abs=0.01)


def test_the_exchange_is_in_lockstep(hover: Flown) -> None:
    """One answer for each question, stamps 4 ms apart, and no question without an answer."""
    counts, peer = hover.report.counts, hover.peer
    assert counts["answered"] == peer["counts"]["HIL_SENSOR"] == 250 * (CLIMBED_S + HOVER_S)
    assert set(peer["sensor_steps_us"]) == {4000}
    assert peer["stamps_in_order"]
    assert peer["bad"] == 0
    assert {"unanswered", "late", "stale", "ahead", "again", "garbage_bytes"}.isdisjoint(counts)


def test_each_message_comes_at_its_rate(hover: Flown) -> None:
    """IMU 250 Hz, compass and barometer 50 Hz, GPS 5 Hz; ground truth as often as was wished."""
    seconds, counts = CLIMBED_S + HOVER_S, hover.peer["counts"]
    imu, slow = 0b111111, 0b1101_111_000000
    assert hover.peer["fields"] == {
        str(imu): 200 * seconds,
        str(imu | slow): 50 * seconds,
    }
    assert counts["HIL_GPS"] == 5 * seconds
    assert counts["HEARTBEAT"] == seconds
    assert counts["DISTANCE_SENSOR"] == 50 * seconds
    assert counts["ODOMETRY"] == pytest.approx(50 * seconds, abs=2)
    # 5 ms were wished for: no turn lies there, and every 8 ms is the next
    assert counts["HIL_STATE_QUATERNION"] == pytest.approx(125 * seconds, abs=2)
    assert hover.peer["acks"] == [[511, 0]]
    latitude, longitude, _, fix = hover.peer["home"]
    assert (latitude / 1e7, longitude / 1e7) == pytest.approx((47.3977, 8.5456), abs=1e-3)
    assert fix == 3


def test_the_same_flight_is_the_same_bit_for_bit(plain: Flown) -> None:
    """Two processes, two sockets, and not one bit of difference."""
    again = fly("--seconds", "8")
    assert np.array_equal(again.places, plain.places)
    assert again.peer["track"] == plain.peer["track"]


@pytest.mark.parametrize("fault", ["halves", "garbage_between", "twice"])
def test_noise_on_the_line_changes_nothing(fault: str, plain: Flown) -> None:
    """Messages in pieces, garbage between them, old and second answers: the same flight."""
    noisy = fly("--seconds", "8", "--fault", fault)
    assert not noisy.report.failed
    assert np.array_equal(noisy.places, plain.places)
    counts = noisy.report.counts
    assert counts["answered"] == plain.report.counts["answered"]
    if fault == "garbage_between":
        assert counts["garbage_bytes"] > 1000
    if fault == "twice":
        # a second answer is seen with the first one, or with the next: old then
        assert counts.get("again", 0) + counts["stale"] > 900


def test_controls_that_are_no_numbers_stop_a_motor_and_are_counted(plain: Flown) -> None:
    """Five answers with a NaN: that motor stands still for 20 ms, and the flight goes on."""
    flown = fly("--seconds", "12", "--fault", "nan")
    assert not flown.report.failed
    assert flown.report.counts["not_a_number"] == 5
    n = len(plain.truths)
    assert not np.array_equal(flown.places[:n], plain.places)
    assert np.linalg.norm(flown.places[-1] - plain.places[-1]) < 0.2


def test_controls_out_of_range_are_cut_and_counted() -> None:
    """-7 and 1e30 are 0 and 1, for as long as they last."""
    flown = fly("--seconds", "9", "--fault", "wild")
    assert not flown.report.failed
    assert flown.report.counts["out_of_range"] >= 16
    assert flown.places[-1][2] == pytest.approx(1.2, abs=0.3)


def test_a_disarmed_drone_falls() -> None:
    """Whatever the controls say, the rotors of a disarmed drone stand still."""
    flown = fly("--seconds", "8", "--fault", "disarms")
    assert not flown.report.failed
    assert max(flown.places[:, 2]) > 1.0
    assert flown.places[-1][2] < 0.1
    assert flown.report.armed_s == pytest.approx(5.0, abs=0.01)


def test_who_goes_may_come_back_and_begins_anew(plain: Flown) -> None:
    """A peer that leaves in flight ends it; the next one at the same door has a fresh start."""
    with closing(Door("127.0.0.1", 0)) as door:
        gone = fly_at(door, "--fault", "leaves")
        back = fly_at(door, "--seconds", "8")
    assert not gone.report.failed
    assert "the connection" in gone.report.why
    assert gone.report.simulated_s == pytest.approx(6.0, abs=0.01)
    assert np.array_equal(back.places, plain.places)


HASTY = Patience(first_s=60.0, idle_s=60.0, armed_s=0.05, hung_s=0.5)


@pytest.mark.parametrize(
    ("fault", "waits", "why"),
    [
        ("hangs", HASTY, "it flew until then"),
        ("old_stamps", HASTY, r"\d+ controls carried old stamps"),
        ("future_stamps", HASTY, r"\d+ stamps that are yet to come"),
        ("no_lockstep", PATIENT, "built without lockstep"),
        ("silent", Patience(first_s=0.1, boot_s=1.0), "PWM_MAIN_FUNC1"),
        ("garbage_only", PATIENT, "without one MAVLink message"),
        ("flood", PATIENT, "bytes came in place of one answer"),
    ],
)
def test_who_cannot_fly_is_told_why(fault: str, waits: Patience, why: str) -> None:
    """Silence, clocks that are not the simulated one, garbage and floods end with a sentence."""
    flown = fly("--fault", fault, "--fault-s", "2", waits=waits)
    assert flown.report.failed
    assert re.search(why, flown.report.why), flown.report.why


def test_a_hung_peer_is_waited_for_with_bounds() -> None:
    """While an answer misses, time goes on in steps of 4 ms, by no more than the wait allows."""
    waits = Patience(first_s=60.0, idle_s=60.0, armed_s=0.3, hung_s=3.0)
    flown = fly("--fault", "hangs", "--fault-s", "2", waits=waits)
    unanswered = flown.report.counts["unanswered"]
    assert 1 <= unanswered <= 11
    assert flown.report.simulated_s == pytest.approx(3.0 + 0.004 * unanswered, abs=0.005)


def test_who_boots_gets_time_and_no_gps_or_vio_if_not_wanted() -> None:
    """Without an answer simulated time goes on at the pace of the wait for one."""
    flown = fly(
        "--fault",
        "silent",
        waits=Patience(first_s=0.01, idle_s=0.004, boot_s=1.0),
        settings=HilSettings(gps=False, vio=False),
    )
    assert 0.0 < flown.report.simulated_s <= 1.1
    assert flown.report.counts["unanswered"] == flown.report.counts["asked"]
    assert np.ptp(flown.places[25:, 2]) < 1e-3


def test_the_pace_is_kept() -> None:
    """Ten simulated seconds in one of the clock are a tenth of the time, and not less."""
    flown = fly("--seconds", "4", speed=10.0)
    assert flown.report.took_s >= 0.39
