"""What leaves beside HIL_SENSOR, and how often."""

from __future__ import annotations

import math
from collections import Counter

import pytest
from pymavlink.dialects.v20 import common as mav

from contact_sim.hil.instruments import Reading
from contact_sim.hil.outgoing import Outgoing
from contact_sim.hil.place import Place
from contact_sim.hil.reader import Interval, Unknown
from contact_sim.simulation import Simulation
from tests.unit.contact_sim.flights import simulation

GPS, STATE = mav.MAVLINK_MSG_ID_HIL_GPS, mav.MAVLINK_MSG_ID_HIL_STATE_QUATERNION


@pytest.fixture(scope="module")
def sim() -> Simulation:
    flown = simulation()
    flown.step(20)  # there is a VIO and a height by now
    return flown


def outgoing(*, gps: bool = True, vio: bool = True) -> Outgoing:
    return Outgoing(Place(), gps=gps, vio=vio)


def questions(sim: Simulation, out: Outgoing, turns: int) -> list[list[mav.MAVLink_message]]:
    """Of so many turns, as they are heard."""
    line, heard = mav.MAVLink(None), []
    for i in range(turns):
        reading = Reading(i * 4_000_000, (0, 0, -9.81), (0, 0, 0), None, None)
        heard.append(line.parse_buffer(out.question(sim, reading)))
    return heard


def counted(heard: list[list[mav.MAVLink_message]]) -> Counter[str]:
    return Counter(m.get_type() for q in heard for m in q)


def rates(sim: Simulation, out: Outgoing) -> Counter[str]:
    """Messages in a simulated second."""
    return counted(questions(sim, out, 250))


def test_the_usual_rates(sim):
    """In a simulated second."""
    assert rates(sim, outgoing()) == {
        "HIL_SENSOR": 250,
        "ODOMETRY": 50,
        "DISTANCE_SENSOR": 50,
        "HIL_STATE_QUATERNION": 50,
        "HIL_GPS": 5,
        "HEARTBEAT": 1,
    }


def test_what_is_not_wanted_does_not_leave(sim):
    """No home, and no VIO where the client passes it on."""
    sent = rates(sim, outgoing(gps=False, vio=False))
    assert sent.keys() == {"HIL_SENSOR", "HIL_STATE_QUATERNION", "HEARTBEAT"}


def test_the_sensors_come_last_and_numbers_go_up(sim):
    """What came before is there when PX4's clock moves on; no message is missing in between."""
    heard = questions(sim, outgoing(), 60)
    assert all(q[-1].get_type() == "HIL_SENSOR" for q in heard)
    numbers = [m.get_seq() for q in heard for m in q]
    assert numbers == [i % 256 for i in range(len(numbers))]


def test_a_wish_is_heeded_and_acknowledged(sim):
    """Ground truth every 8 ms; the next question carries the acknowledgement."""
    out = outgoing()
    out.heed(Interval(STATE, 8000.0))
    heard = questions(sim, out, 250)
    ack = heard[0][0]
    assert (ack.get_type(), ack.command, ack.result) == ("COMMAND_ACK", 511, 0)
    assert counted(heard)["COMMAND_ACK"] == 1
    assert counted(heard)["HIL_STATE_QUATERNION"] == 125


@pytest.mark.parametrize(
    ("interval_us", "sent"),
    [(-1.0, 0), (0.0, 50), (1.0, 250), (math.inf, 1), (1e30, 1), (-math.inf, 0)],
)
def test_wishes_have_bounds(sim, interval_us, sent):
    """Never, as usual, at most at every turn, and never so rarely that a number overflows."""
    out = outgoing()
    out.heed(Interval(STATE, interval_us))
    assert rates(sim, out)["HIL_STATE_QUATERNION"] == sent


@pytest.mark.parametrize(
    "wish", [Interval(GPS, math.nan), Interval(mav.MAVLINK_MSG_ID_RAW_IMU, 5000.0), Unknown(400)]
)
def test_what_is_not_offered_is_refused(sim, wish):
    """In words of MAVLink, and nothing else changes."""
    out = outgoing()
    out.heed(wish)
    heard = questions(sim, out, 250)
    (ack,) = [m for q in heard for m in q if m.get_type() == "COMMAND_ACK"]
    assert ack.result == mav.MAV_RESULT_UNSUPPORTED
    assert counted(heard)["HIL_GPS"] == 5
