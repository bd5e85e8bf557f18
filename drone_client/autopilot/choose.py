"""Opens an autopilot by its address.

======================================  =========================================================
``udp/127.0.0.1:14540``                 PX4 that sends there by itself (its simulator does)
``udp/0.0.0.0:14540``                   the same, from another machine
``udpout/192.0.2.7:14550``              PX4 that listens there: we speak first
``serial//dev/ttyACM0:921600``          PX4 at the other end of a wire
``ardupilot+udp/127.0.0.1:14550``       an ArduPilot copter; likewise with the others
======================================  =========================================================
"""

from __future__ import annotations

import ipaddress
import re

from drone_client.autopilot.ardupilot import ARDUPILOT
from drone_client.autopilot.flavour import Flavour
from drone_client.autopilot.line import Line, SerialLine, UdpLine
from drone_client.autopilot.mavlink import MavlinkAutopilot
from drone_client.autopilot.px4 import PX4
from drone_client.autopilot.settings import AutopilotSettings
from drone_client.errors import AutopilotError
from rgbd_wire.clock import Clock

EXAMPLES = (
    "udp/127.0.0.1:14540, udpout/192.0.2.7:14550, serial//dev/ttyACM0:921600 or "
    "ardupilot+udp/127.0.0.1:14550"
)
BAUD_MIN, BAUD_MAX = 9600, 4_000_000
ADDRESS_MAX = 300

_FLAVOURS = {"px4": PX4, "ardupilot": ARDUPILOT}
_KINDS = ("udp", "udpout", "serial")
_HOST_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")


def open_autopilot(
    address: str, clock: Clock, settings: AutopilotSettings | None = None
) -> MavlinkAutopilot:
    """Open the line and begin to listen; nothing is asked for and no setpoint leaves yet.

    Args:
        address: see above.
        clock: the drone's.
        settings: rates, ids, limits; None: the usual ones.

    Raises:
        AutopilotError: the address is malformed, or its line cannot be opened.
    """
    flavour, kind, place, number = parse_address(address)
    line: Line
    if kind == "serial":
        line = SerialLine(place, number)
    else:
        line = UdpLine(place, number, speak_first=kind == "udpout")
    return MavlinkAutopilot(line, flavour, clock, settings or AutopilotSettings())


def parse_address(address: str) -> tuple[Flavour, str, str, int]:
    """Flavour, kind of line, host or device, and port or baud rate.

    Raises:
        AutopilotError: says what is wrong with the address.
    """
    shown = address if len(address) <= ADDRESS_MAX else address[:40] + "..."
    scheme, slash, rest = address.partition("/")
    flavour_name, plus, kind = scheme.rpartition("+")
    if not plus:
        flavour_name = "px4"
    if not slash or kind not in _KINDS or len(address) > ADDRESS_MAX:
        raise AutopilotError(f"autopilot {shown!r} is no address; such as {EXAMPLES}")
    flavour = _FLAVOURS.get(flavour_name)
    if flavour is None:
        known = " or ".join(f"{name}+" for name in _FLAVOURS)
        raise AutopilotError(
            f"autopilot {shown!r}: {flavour_name}+ is not known, only {known} (or nothing: PX4)"
        )
    place, colon, digits = rest.rpartition(":")
    if not colon:
        place, digits = rest, ""
    number = int(digits) if digits.isascii() and digits.isdigit() and len(digits) <= 9 else -1
    if kind == "serial":
        if not place.startswith("/"):
            raise AutopilotError(
                f"autopilot {shown!r}: a serial device begins with /, such as "
                "serial//dev/ttyACM0:921600 (two strokes)"
            )
        if not colon or not BAUD_MIN <= number <= BAUD_MAX:
            raise AutopilotError(
                f"autopilot {shown!r}: {digits!r} is no baud rate, expected {BAUD_MIN} to "
                f"{BAUD_MAX}, as in serial//dev/ttyACM0:921600"
            )
        return flavour, kind, place, number
    if not colon or not 1 <= number <= 0xFFFF:
        raise AutopilotError(
            f"autopilot {shown!r}: {digits!r} is no port, expected 1 to 65535, as in "
            "udp/127.0.0.1:14540"
        )
    host = place[1:-1] if place.startswith("[") and place.endswith("]") else place
    if not _is_host(host):
        raise AutopilotError(
            f"autopilot {shown!r}: {host!r} is no host, as in udp/127.0.0.1:14540 or "
            "udp/[::1]:14540"
        )
    return flavour, kind, host, number


def _is_host(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return _HOST_NAME.fullmatch(host) is not None
    return True
