"""The messages of a simulator for PX4, built from values in ENU and FLU. Pure.

Units are what the dialect asks for: 1e-7 degrees, millimetres, centimetres a second, milli-g.
"""

from __future__ import annotations

import math
from typing import Final

from pymavlink.dialects.v20 import common as mav

from contact_sim.hil.instruments import Reading, frd_from_flu
from contact_sim.hil.place import Place
from contact_sim.simulation import Truth
from drone_client.autopilot.ned import swap_attitude, swap_world
from rgbd_wire.geometry import vec3

GRAVITY_MPS2: Final = 9.80665
"""Of MAVLink's milli-g."""
IMU_FIELDS: Final = (
    mav.HIL_SENSOR_UPDATED_XACC
    | mav.HIL_SENSOR_UPDATED_YACC
    | mav.HIL_SENSOR_UPDATED_ZACC
    | mav.HIL_SENSOR_UPDATED_XGYRO
    | mav.HIL_SENSOR_UPDATED_YGYRO
    | mav.HIL_SENSOR_UPDATED_ZGYRO
)
COMPASS_FIELDS: Final = (
    mav.HIL_SENSOR_UPDATED_XMAG | mav.HIL_SENSOR_UPDATED_YMAG | mav.HIL_SENSOR_UPDATED_ZMAG
)
BAROMETER_FIELDS: Final = (
    mav.HIL_SENSOR_UPDATED_ABS_PRESSURE
    | mav.HIL_SENSOR_UPDATED_PRESSURE_ALT
    | mav.HIL_SENSOR_UPDATED_TEMPERATURE
)
"""PX4 takes a pressure only together with its height and temperature."""
FIX_3D: Final = 3
EPH_CM, EPV_CM, SATELLITES = 50, 80, 14


def heartbeat() -> mav.MAVLink_message:
    """A simulator is here."""
    return mav.MAVLink_heartbeat_message(
        mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3
    )


def hil_sensor(reading: Reading) -> mav.MAVLink_message:
    """HIL_SENSOR: ``fields_updated`` marks what is new; PX4's clock becomes its stamp."""
    fields = IMU_FIELDS
    field = (0.0, 0.0, 0.0)
    pressure_hpa = altitude_m = temperature_c = 0.0
    if reading.field_frd is not None:
        fields |= COMPASS_FIELDS
        field = reading.field_frd
    if reading.air is not None:
        fields |= BAROMETER_FIELDS
        pressure_hpa, altitude_m, temperature_c = reading.air
    return mav.MAVLink_hil_sensor_message(
        reading.t_ns // 1000,
        *reading.force_frd,
        *reading.rates_frd,
        *field,
        pressure_hpa,
        0.0,  # no pitot tube
        altitude_m,
        temperature_c,
        fields,
        0,
    )


def hil_gps(truth: Truth, place: Place) -> mav.MAVLink_message:
    """HIL_GPS of a receiver that is right: a home for PX4 to arm at, not a source to fly by."""
    at = place.geodetic(vec3(truth.world_from_body.translation))
    north, east, down = swap_world(truth.velocity_world).tolist()
    course = math.degrees(math.atan2(east, north)) % 360.0
    return mav.MAVLink_hil_gps_message(
        truth.t_ns // 1000,
        FIX_3D,
        round(at.latitude_deg * 1e7),
        round(at.longitude_deg * 1e7),
        round(at.altitude_m * 1e3),
        EPH_CM,
        EPV_CM,
        _short(math.hypot(north, east) * 100.0),
        _short(north * 100.0),
        _short(east * 100.0),
        _short(down * 100.0),
        round(course * 100.0) % 36_000,
        SATELLITES,
    )


def hil_state(truth: Truth, reading: Reading, place: Place) -> mav.MAVLink_message:
    """HIL_STATE_QUATERNION: how it really is, for PX4's log."""
    at = place.geodetic(vec3(truth.world_from_body.translation))
    north, east, down = swap_world(truth.velocity_world).tolist()
    roll, pitch, yaw = frd_from_flu(vec3(truth.rates_body))
    x, y, z = (_short(f / GRAVITY_MPS2 * 1000.0) for f in reading.force_frd)
    flow = [v - w for v, w in zip(truth.velocity_world.tolist(), truth.wind_world, strict=True)]
    airspeed = _short(math.hypot(*flow) * 100.0)
    return mav.MAVLink_hil_state_quaternion_message(
        truth.t_ns // 1000,
        swap_attitude(truth.world_from_body.q_wxyz).tolist(),
        roll,
        pitch,
        yaw,
        round(at.latitude_deg * 1e7),
        round(at.longitude_deg * 1e7),
        round(at.altitude_m * 1e3),
        _short(north * 100.0),
        _short(east * 100.0),
        _short(down * 100.0),
        airspeed,
        airspeed,
        x,
        y,
        z,
    )


def acknowledged(command: int, *, taken: bool) -> mav.MAVLink_message:
    """COMMAND_ACK."""
    result = mav.MAV_RESULT_ACCEPTED if taken else mav.MAV_RESULT_UNSUPPORTED
    return mav.MAVLink_command_ack_message(command, result)


def _short(value: float) -> int:
    """Into 16 bits with a sign, at their ends if need be."""
    return max(-32_768, min(32_767, round(value)))
