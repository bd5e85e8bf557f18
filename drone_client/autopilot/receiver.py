"""Bytes from the line into messages of the one autopilot that we listen to. What comes is hostile.

Bounded in memory and in work: so many bytes in a tenth of a second are looked at and no more, the
parser's buffer is cut, and whatever is refused is counted under its reason. Nothing raises.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from pymavlink.dialects.v20 import common as mav

WINDOW_NS = 100_000_000
BYTES_PER_WINDOW = 100_000
"""1 MB/s: ten times what an autopilot sends over a fast line."""
BUFFER_MAX = 4096
HANDLED = frozenset(
    (
        "HEARTBEAT",
        "COMMAND_ACK",
        "TIMESYNC",
        "ODOMETRY",
        "LOCAL_POSITION_NED",
        "ATTITUDE_QUATERNION",
        "BATTERY_STATUS",
        "EXTENDED_SYS_STATE",
        "STATUSTEXT",
        "PARAM_VALUE",
    )
)


class Receiver:
    """The parser of one line; not thread-safe."""

    def __init__(
        self, autopilot: int, own_component: int, system: int | None = None, component: int = 1
    ) -> None:
        """Listen to one component of one system.

        Args:
            autopilot: MAV_AUTOPILOT of the kind that we speak with: modes have other numbers with
                every kind.
            own_component: ours; what seems to come from it is our own echo.
            system: the autopilot's system id; None: of the first autopilot that is heard.
            component: the autopilot's component id.
        """
        self.refused: Counter[str] = Counter()
        """What was not listened to, by reason: ``garbage``, ``flood``, ``other_system``, ..."""
        self.accepted: Counter[str] = Counter()
        """Messages by name."""
        self.mavlink1 = 0
        """Messages that came as MAVLink 1: an autopilot begins so, until it hears MAVLink 2."""
        self.signed = 0
        """Messages with a signature; it is not checked, for there is no shared secret."""
        self.system = system
        self.component = component
        self._autopilot = autopilot
        self._own_component = own_component
        self._parser = _new_parser()
        self._window_ns = 0
        self._window_bytes = 0

    def over_budget(self, now_ns: int) -> bool:
        """Whether more has come in this tenth of a second than is looked at."""
        if not 0 <= now_ns - self._window_ns < WINDOW_NS:
            self._window_ns, self._window_bytes = now_ns, 0
        return self._window_bytes >= BYTES_PER_WINDOW

    def start_datagram(self) -> None:
        """Forget a message that was cut off: a datagram holds whole ones."""
        if self._parser.buf_len():
            self.refused["cut_off"] += 1
            self._parser = _new_parser()

    def messages(self, data: bytes, now_ns: int) -> Iterator[mav.MAVLink_message]:
        """The messages in ``data`` that are the autopilot's and of a kind that we handle."""
        if self.over_budget(now_ns):
            self.refused["flood"] += 1
            return
        self._window_bytes += len(data)
        for message in self._parse(data):
            reason = self._refusal(message)
            if reason:
                self.refused[reason] += 1
            else:
                self.accepted[message.get_type()] += 1
                yield message

    def _parse(self, data: bytes) -> list[mav.MAVLink_message]:
        parser = self._parser
        try:
            found = parser.parse_buffer(data) or []
        except Exception:
            # pymavlink raises its own errors only, as far as we know; a parser that has raised
            # another is in a state that nobody knows
            self.refused["parser_error"] += 1
            self._parser = _new_parser()
            return []
        if parser.buf_index > BUFFER_MAX:
            # It frees its buffer only when nothing is left over, which on a busy line is never
            del parser.buf[: parser.buf_index]
            parser.buf_index = 0
        return found

    def _refusal(self, message: mav.MAVLink_message) -> str:
        """Why a message is not listened to; empty: it is."""
        kind = message.get_type()
        if kind == "BAD_DATA":
            return "garbage"
        if kind.startswith("UNKNOWN"):
            return "unknown_message"
        if message.get_srcComponent() != self.component:
            own = message.get_srcComponent() == self._own_component
            return "own_echo" if own else "other_component"
        if kind == "HEARTBEAT" and message.autopilot != self._autopilot:
            return "other_autopilot"
        if self.system is None:
            if kind != "HEARTBEAT" or message.get_srcSystem() == 0:
                return "not_chosen_yet"
            self.system = message.get_srcSystem()
        if message.get_srcSystem() != self.system:
            return "other_system"
        buffer = message.get_msgbuf()
        self.mavlink1 += buffer[0] == mav.PROTOCOL_MARKER_V1
        self.signed += (
            buffer[0] == mav.PROTOCOL_MARKER_V2 and buffer[2] & mav.MAVLINK_IFLAG_SIGNED != 0
        )
        return "" if kind in HANDLED else "not_handled"


def _new_parser() -> mav.MAVLink:
    mav.MAVLINK_IGNORE_CRC = 0  # no variable of the environment shall switch the checksum off
    parser = mav.MAVLink(None)
    parser.robust_parsing = True
    return parser
