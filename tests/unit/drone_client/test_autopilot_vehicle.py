"""What is made of the autopilot's messages, and what is not taken."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot import ardupilot, px4
from drone_client.autopilot.timesync import Timesync
from drone_client.autopilot.vehicle import Vehicle

NOW = 50_000_000_000
MS = 1_000_000


def odometry(
    *,
    place: tuple[float, float, float] = (1.0, 2.0, -3.0),
    q: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    velocity: tuple[float, float, float] = (0.1, 0.2, -0.3),
    frame: int = mav.MAV_FRAME_LOCAL_NED,
    child: int = mav.MAV_FRAME_LOCAL_NED,
) -> mav.MAVLink_message:
    nan = [math.nan] * 21
    return mav.MAVLink_odometry_message(
        0, frame, child, *place, list(q), *velocity, 0.0, 0.0, 0.0, nan, nan, 5
    )


def heartbeat(status: int = mav.MAV_STATE_ACTIVE, base: int = 128) -> mav.MAVLink_message:
    return mav.MAVLink_heartbeat_message(2, 12, base, 0, status, 3)


def heard() -> Vehicle:
    vehicle = Vehicle()
    vehicle.heartbeat(heartbeat(), "POSCTL", NOW)
    return vehicle


def test_before_the_first_heartbeat_nothing_is_known() -> None:
    """Not even when a pose came."""
    vehicle = Vehicle()
    vehicle.odometry_in(odometry(), NOW, NOW)
    assert vehicle.state(obeying=True, now_ns=NOW) is None


def test_odometry_becomes_a_pose_on_our_axes() -> None:
    """Facing north at rest in NED is facing y in ENU."""
    vehicle = heard()
    vehicle.odometry_in(odometry(), NOW - 10 * MS, NOW)
    state = vehicle.state(obeying=True, now_ns=NOW)
    assert state is not None
    assert state.t_pose_ns == NOW - 10 * MS
    assert state.world_from_body is not None
    assert np.allclose(state.world_from_body.translation, [2.0, 1.0, 3.0])
    assert np.allclose(state.world_from_body.rotation[:, 0], [0.0, 1.0, 0.0])
    assert np.allclose(state.velocity_world, [0.2, 0.1, 0.3])
    assert vehicle.odometry is not None
    assert vehicle.odometry.resets == 5
    assert state.pose_resets == 5


def test_a_velocity_of_the_body_is_turned() -> None:
    """Forward at a heading of east (90 degrees) is east."""
    vehicle = heard()
    q = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    vehicle.odometry_in(
        odometry(q=q, velocity=(1.0, 0.0, 0.0), child=mav.MAV_FRAME_BODY_FRD), NOW, NOW
    )
    assert vehicle.odometry is not None
    assert np.allclose(vehicle.odometry.velocity_world, [1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("message", "t_ns", "reason"),
    [
        (odometry(), None, "clock_not_known"),
        (odometry(), NOW - 1001 * MS, "stamp"),
        (odometry(), NOW + 21 * MS, "stamp"),
        (odometry(velocity=(math.nan, 0, 0)), NOW, "not_finite"),
        (odometry(place=(math.inf, 0, 0)), NOW, "not_a_pose"),
        (odometry(q=(0.0, 0.0, 0.0, 0.0)), NOW, "not_a_pose"),
        (odometry(frame=mav.MAV_FRAME_LOCAL_ENU), NOW, "odometry_frame"),
        (odometry(child=mav.MAV_FRAME_LOCAL_FLU), NOW, "odometry_frame"),
    ],
)
def test_what_is_no_pose_of_now_is_refused(
    message: mav.MAVLink_message, t_ns: int | None, reason: str
) -> None:
    """Refused under its reason, and the pose before stays as it was."""
    vehicle = heard()
    vehicle.odometry_in(message, t_ns, NOW)
    assert vehicle.refused == {reason: 1}
    assert vehicle.odometry is None


def test_an_older_pose_does_not_replace_a_newer() -> None:
    """UDP may swap datagrams."""
    vehicle = heard()
    vehicle.odometry_in(odometry(), NOW - 20 * MS, NOW)
    vehicle.odometry_in(odometry(place=(9.0, 9.0, 9.0)), NOW - 40 * MS, NOW)
    assert vehicle.refused == {"out_of_order": 1}
    assert vehicle.odometry is not None
    assert vehicle.odometry.t_ns == NOW - 20 * MS


@given(
    st.lists(st.floats(width=32), min_size=10, max_size=10),
    st.integers(0, 255),
    st.integers(0, 255),
)
def test_any_numbers_are_survived(numbers: list[float], frame: int, child: int) -> None:
    """A pose that is taken is finite and a rotation; all else is counted."""
    vehicle = heard()
    vehicle.odometry_in(
        odometry(
            place=tuple(numbers[:3]),
            q=tuple(numbers[3:7]),
            velocity=tuple(numbers[7:]),
            frame=frame,
            child=child,
        ),
        NOW,
        NOW,
    )
    state = vehicle.state(obeying=False, now_ns=NOW)
    assert state is not None
    assert (state.world_from_body is None) == (sum(vehicle.refused.values()) == 1)


def test_place_and_attitude_make_a_pose_while_odometry_is_missing() -> None:
    """LOCAL_POSITION_NED and ATTITUDE_QUATERNION, at most 50 ms apart; ODOMETRY comes first."""
    vehicle = heard()
    place = mav.MAVLink_local_position_ned_message(0, 1.0, 2.0, -3.0, 0.0, 0.0, 0.0)
    attitude = mav.MAVLink_attitude_quaternion_message(0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    vehicle.attitude(attitude, NOW - 60 * MS, NOW)
    vehicle.position(place, NOW - 5 * MS, NOW)
    assert vehicle.odometry is None
    vehicle.attitude(attitude, NOW - 10 * MS, NOW)
    assert vehicle.odometry is not None
    assert np.allclose(vehicle.odometry.world_from_body.translation, [2.0, 1.0, 3.0])
    vehicle.odometry_in(odometry(place=(7.0, 7.0, 7.0)), NOW, NOW)
    vehicle.position(place, NOW + 1, NOW + 1)
    vehicle.attitude(attitude, NOW + 1, NOW + 1)
    assert vehicle.odometry.t_ns == NOW


def test_failsafes_are_told_in_words() -> None:
    """The state, the battery, and the autopilot's own words while they are fresh."""
    vehicle = heard()
    vehicle.status_text(mav.MAVLink_statustext_message(2, b"No offboard signal\n"), NOW)
    vehicle.status_text(mav.MAVLink_statustext_message(6, b"chatter"), NOW)
    vehicle.heartbeat(heartbeat(mav.MAV_STATE_CRITICAL), "AUTO.LAND", NOW)
    battery = mav.MAVLink_battery_status_message(
        0, 0, 1, 0, [0] * 10, -1, -1, -1, 12, 0, mav.MAV_BATTERY_CHARGE_STATE_CRITICAL
    )
    vehicle.battery(battery)
    state = vehicle.state(obeying=False, now_ns=NOW)
    assert state is not None
    assert state.failsafe == 'a failsafe acts ("No offboard signal"), battery critical'
    assert state.battery_fraction == pytest.approx(0.12)
    later = vehicle.state(obeying=False, now_ns=NOW + 11_000_000_000)
    assert later is not None
    assert later.failsafe == "a failsafe acts, battery critical"


def test_a_battery_that_does_not_say_is_unknown() -> None:
    """-1 is no charge; a second battery is not the first."""
    vehicle = heard()
    for number, remaining in ((0, -1), (1, 50)):
        vehicle.battery(
            mav.MAVLink_battery_status_message(
                number, 0, 1, 0, [0] * 10, -1, -1, -1, remaining, 0, 0
            )
        )
    state = vehicle.state(obeying=False, now_ns=NOW)
    assert state is not None
    assert state.battery_fraction is None


def test_only_an_armed_vehicle_obeys() -> None:
    """The order of modes says engaged, the motors stand: it does not obey."""
    vehicle = heard()
    assert vehicle.state(obeying=True, now_ns=NOW).obeying
    vehicle.heartbeat(heartbeat(base=0), "OFFBOARD", NOW)
    assert not vehicle.state(obeying=True, now_ns=NOW).obeying


@pytest.mark.parametrize(
    ("custom_mode", "name"),
    [
        (6 << 16, "OFFBOARD"),
        (3 << 16, "POSCTL"),
        (4 << 16 | 3 << 24, "AUTO.LOITER"),
        (4 << 16 | 6 << 24, "AUTO.LAND"),
        (4 << 16 | 77 << 24, "AUTO.77"),
        (99 << 16, "MODE_99"),
    ],
)
def test_px4_modes_have_their_names(custom_mode: int, name: str) -> None:
    """Main mode in the third byte, sub mode in the fourth; unknown ones keep their number."""
    assert px4.mode_name(custom_mode) == name


def test_ardupilot_modes_have_their_names() -> None:
    """The taking and the holding mode are the ones that are asked for."""
    flavour = ardupilot.ARDUPILOT
    assert ardupilot.mode_name(flavour.take[0]) == flavour.taking_mode == "GUIDED"
    assert ardupilot.mode_name(flavour.hold[0]) == "BRAKE"
    assert ardupilot.mode_name(4711) == "MODE_4711"


def test_timesync_counts_only_answers_to_our_questions() -> None:
    """A forged, a doubled and a late answer are counted; the true one gives the offset."""
    sync = Timesync()
    offset = -7_000_000_000
    assert sync.ours_ns(1, NOW) is None
    t1 = sync.ask(NOW)
    sync.answered(NOW + offset, t1 + 1, NOW + 2 * MS)
    assert sync.offset_ns(NOW) is None
    sync.answered(t1 + MS + offset, t1, t1 + 2 * MS)
    estimate = sync.offset_ns(t1 + 2 * MS)
    assert estimate is not None
    assert estimate[0] == pytest.approx(offset, abs=MS)
    assert estimate[1] <= 1.1 * MS
    sync.answered(t1 + MS + offset, t1, t1 + 2 * MS)
    late = sync.ask(NOW)
    sync.answered(NOW + offset, late, NOW + 300 * MS)
    assert sync.unused == 3
    assert sync.ours_ns(NOW + offset, t1 + 2 * MS) == pytest.approx(NOW, abs=2 * MS)


def test_a_rebooted_autopilot_is_a_new_clock() -> None:
    """Its clock begins again at zero: the old offset is forgotten at once."""
    sync = Timesync()
    for offset in (10**12, 10**9):
        for i in range(3):
            t1 = sync.ask(NOW + i * 200 * MS + (offset == 10**9) * 10**9)
            sync.answered(t1 + MS + offset, t1, t1 + 2 * MS)
    assert sync.steps == 1
    estimate = sync.offset_ns(NOW + 10**9 + 500 * MS)
    assert estimate is not None
    assert estimate[0] == pytest.approx(10**9, abs=2 * MS)
