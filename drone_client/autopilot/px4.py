"""PX4: its modes, and the messages that it is asked for."""

from __future__ import annotations

from types import MappingProxyType

from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot.flavour import Flavour
from drone_client.autopilot.parameters import PACKAGED

_AUTO = 4
_OFFBOARD = 6
_LOITER = 3

_MAIN = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    _AUTO: "AUTO",
    5: "ACRO",
    _OFFBOARD: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
    9: "SIMPLE",
    10: "TERMINATION",
    11: "ALTITUDE_CRUISE",
}
_AUTO_SUB = {
    1: "READY",
    2: "TAKEOFF",
    _LOITER: "LOITER",
    4: "MISSION",
    5: "RTL",
    6: "LAND",
    8: "FOLLOW",
    9: "PRECLAND",
    10: "VTOL_TAKEOFF",
}


def mode_name(custom_mode: int) -> str:
    """``POSCTL``, ``AUTO.LAND``: main mode in the third byte, sub mode in the fourth."""
    main, sub = (custom_mode >> 16) & 0xFF, (custom_mode >> 24) & 0xFF
    name = _MAIN.get(main, f"MODE_{main}")
    if main == _AUTO:
        return f"{name}.{_AUTO_SUB.get(sub, str(sub))}"
    return name


PX4 = Flavour(
    name="PX4",
    autopilot=mav.MAV_AUTOPILOT_PX4,
    taking_mode="OFFBOARD",
    take=(_OFFBOARD, 0),
    hold=(_AUTO, _LOITER),
    mode_name=mode_name,
    rates_hz=MappingProxyType(
        {
            mav.MAVLINK_MSG_ID_ODOMETRY: 50.0,
            mav.MAVLINK_MSG_ID_HEARTBEAT: 5.0,  # a pilot's switch is seen sooner
            mav.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
            mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
        }
    ),
    parameter_file=PACKAGED,
    bytewise_parameters=True,
)
