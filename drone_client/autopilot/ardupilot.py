"""ArduPilot's copters: GUIDED in place of OFFBOARD, BRAKE in place of HOLD; all else is shared.

ArduPilot stops by itself 3 s (GUID_TIMEOUT) after the last velocity and stays in GUIDED: its
failsafe for a silent computer is slower than PX4's, and no change of mode tells of it.
"""

from __future__ import annotations

from types import MappingProxyType

from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot.flavour import Flavour

_GUIDED = 4
_BRAKE = 17

_MODES = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    _GUIDED: "GUIDED",
    5: "LOITER",
    6: "RTL",
    7: "CIRCLE",
    9: "LAND",
    11: "DRIFT",
    13: "SPORT",
    14: "FLIP",
    15: "AUTOTUNE",
    16: "POSHOLD",
    _BRAKE: "BRAKE",
    18: "THROW",
    19: "AVOID_ADSB",
    20: "GUIDED_NOGPS",
    21: "SMART_RTL",
    22: "FLOWHOLD",
    23: "FOLLOW",
    24: "ZIGZAG",
    25: "SYSTEMID",
    26: "AUTOROTATE",
    27: "AUTO_RTL",
}


def mode_name(custom_mode: int) -> str:
    """``GUIDED``, ``LOITER``, of ArduCopter's numbers."""
    return _MODES.get(custom_mode, f"MODE_{custom_mode}")


ARDUPILOT = Flavour(
    name="ArduPilot",
    autopilot=mav.MAV_AUTOPILOT_ARDUPILOTMEGA,
    taking_mode="GUIDED",
    take=(_GUIDED, 0),
    hold=(_BRAKE, 0),
    mode_name=mode_name,
    rates_hz=MappingProxyType(
        {
            mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
            mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
            mav.MAVLINK_MSG_ID_HEARTBEAT: 5.0,  # a pilot's switch is seen sooner
            mav.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
            mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
        }
    ),
    parameter_file="ardupilot.params",
    bytewise_parameters=False,
)
