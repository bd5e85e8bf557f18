"""The messages of a simulator, packed and read back by pymavlink."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav
from scipy.spatial.transform import Rotation

from contact_sim.hil import messages
from contact_sim.hil.instruments import Reading
from contact_sim.hil.place import Air, Place
from contact_sim.simulation import Truth
from rgbd_wire.geometry import Pose

PLACE = Place()


def told(message):
    """As the other end of the line reads it."""
    line = mav.MAVLink(None)
    (heard,) = line.parse_buffer(message.pack(mav.MAVLink(None, 1, 1)))
    return heard


def truth(q_wxyz=(1.0, 0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), wind=(0.0, 0.0, 0.0)) -> Truth:
    at = Pose(np.array([10.0, 20.0, 1.5]), np.array(q_wxyz))
    rates = np.array([0.1, 0.2, 0.3])
    tip = np.zeros(3)
    return Truth(12_345_678_000, at, np.array(velocity), rates, tip, 0.0, 0.0, (), 0.0, wind)


READING = Reading(
    12_344_000_000,
    (0.1, -0.2, -9.81),
    (0.01, 0.02, -0.03),
    (0.2, 0.0, 0.4),
    Air(955.0, 496.0, 11.8),
)


def test_a_sensor_message_carries_it_all():
    """m/s2, rad/s, gauss, hPa, metres, degrees; the stamp in microseconds of simulated time."""
    heard = told(messages.hil_sensor(READING))
    assert heard.get_type() == "HIL_SENSOR"
    assert heard.get_msgbuf()[0] == 0xFD
    assert heard.time_usec == 12_344_000
    assert (heard.xacc, heard.yacc, heard.zacc) == pytest.approx(READING.force_frd)
    assert (heard.xgyro, heard.ygyro, heard.zgyro) == pytest.approx(READING.rates_frd)
    assert (heard.xmag, heard.ymag, heard.zmag) == pytest.approx(READING.field_frd)
    assert heard.abs_pressure == pytest.approx(955.0)
    assert (heard.pressure_alt, heard.temperature) == pytest.approx((496.0, 11.8))
    assert heard.diff_pressure == 0.0
    assert heard.fields_updated == 0b1_1011_1111_1111
    assert heard.id == 0


@pytest.mark.parametrize(
    ("field", "air", "bits"),
    [
        (None, None, 0b11_1111),
        (READING.field_frd, None, 0b1_1111_1111),
        (None, READING.air, 0b1_1010_0011_1111),
    ],
)
def test_what_was_not_measured_is_not_marked(field, air, bits):
    """Without a bit PX4 leaves a field alone."""
    reading = READING._replace(field_frd=field, air=air)
    assert told(messages.hil_sensor(reading)).fields_updated == bits


def test_a_fix_is_in_its_odd_units():
    """1e-7 degrees, millimetres, centimetres a second, hundredths of a degree."""
    # 3 m/s east and 4 north, climbing half a metre a second
    heard = told(messages.hil_gps(truth(velocity=(3.0, 4.0, 0.5)), PLACE))
    assert heard.time_usec == 12_345_678
    metre = 1e7 * math.degrees(1 / 6_371_000.0)
    assert heard.lat - PLACE.latitude_deg * 1e7 == pytest.approx(20.0 * metre, abs=1)
    shrunk = math.cos(math.radians(PLACE.latitude_deg))
    assert heard.lon - PLACE.longitude_deg * 1e7 == pytest.approx(10.0 * metre / shrunk, abs=1)
    assert heard.alt == 489_500
    assert (heard.vn, heard.ve, heard.vd, heard.vel) == (400, 300, -50, 500)
    assert heard.cog == round(100 * math.degrees(math.atan2(3, 4)))
    assert heard.fix_type == 3


@pytest.mark.parametrize(("velocity", "course"), [((-1.0, 0.0, 0.0), 27_000), ((0, -1, 0), 18_000)])
def test_a_course_is_from_0_to_360(velocity, course):
    """West is 270 degrees."""
    assert told(messages.hil_gps(truth(velocity=velocity), PLACE)).cog == course


def test_the_ground_truth_is_in_ned_and_frd():
    """By SciPy: facing east in ENU is a heading of 90 degrees; the rest in milli-g and cm/s."""
    heard = told(
        messages.hil_state(truth(velocity=(1.0, 2.0, 3.0), wind=(1.0, 0.0, 3.0)), READING, PLACE)
    )
    w, x, y, z = heard.attitude_quaternion
    yaw, pitch, roll = Rotation.from_quat([x, y, z, w]).as_euler("ZYX", degrees=True)
    assert (yaw, pitch, roll) == pytest.approx((90.0, 0.0, 0.0), abs=1e-4)
    assert (heard.rollspeed, heard.pitchspeed, heard.yawspeed) == pytest.approx((0.1, -0.2, -0.3))
    assert (heard.vx, heard.vy, heard.vz) == (200, 100, -300)
    assert heard.true_airspeed == 200
    assert (heard.xacc, heard.yacc, heard.zacc) == (10, -20, -1000)


def test_what_is_too_fast_for_16_bits_is_cut():
    """And does not turn its sign."""
    heard = told(messages.hil_gps(truth(velocity=(0.0, -1e4, 1e4)), PLACE))
    assert (heard.vn, heard.vd, heard.vel) == (-32_768, -32_768, 32_767)


def test_commands_are_acknowledged():
    """Taken, or not known."""
    assert told(messages.acknowledged(511, taken=True)).result == mav.MAV_RESULT_ACCEPTED
    assert told(messages.acknowledged(9, taken=False)).result == mav.MAV_RESULT_UNSUPPORTED
    assert told(messages.heartbeat()).autopilot == mav.MAV_AUTOPILOT_INVALID
