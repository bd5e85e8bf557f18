"""Bytes of a PX4 into its controls and wishes. What comes is hostile: bounded, counted.

Bytes between messages are garbage; so much of it without one good message, and whoever is there
speaks something else.
"""

from __future__ import annotations

from collections import Counter
from typing import Final, NamedTuple, TypeAlias

from pymavlink.dialects.v20 import common as mav

from contact_sim.errors import HilError
from contact_sim.hil.motors import Controls

MAX_GARBAGE_BYTES: Final = 65_536
BUFFER_MAX: Final = 4096


class Interval(NamedTuple):
    """COMMAND_LONG SET_MESSAGE_INTERVAL: a message that is wished for."""

    message: int
    interval_us: float
    """-1: never, 0: as usual."""


class Unknown(NamedTuple):
    """Any other COMMAND_LONG."""

    command: int


Word: TypeAlias = Controls | Interval | Unknown


class Reader:
    """The parser of one connection."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        """What came: ``controls``, ``heartbeats``, ``others``; ``garbage_bytes``."""
        self.system: int | None = None
        """MAVLink's number of whoever is there."""
        self._garbage = 0
        self._parser = _new_parser()

    def take(self, data: bytes) -> list[Word]:
        """The words in what came, in their order.

        Raises:
            HilError: it is garbage, and more of it than an accident explains.
        """
        words = []
        for message in self._parse(data):
            kind = message.get_type()
            if kind == "BAD_DATA":
                self._count_garbage(len(message.data))
                continue
            if kind.startswith("UNKNOWN"):  # of which pymavlink checks no checksum
                self._count_garbage(len(message.get_msgbuf()))
                continue
            self._garbage = 0
            self.system = message.get_srcSystem()
            word = self._word(kind, message)
            if word is not None:
                words.append(word)
        return words

    def _parse(self, data: bytes) -> list[mav.MAVLink_message]:
        parser = self._parser
        try:
            found: list[mav.MAVLink_message] = parser.parse_buffer(data) or []
        except Exception:
            # pymavlink raises its own errors only, as far as we know; a parser that has raised
            # another is in a state that nobody knows
            self._count_garbage(len(data))
            self._parser = _new_parser()
            return []
        if parser.buf_index > BUFFER_MAX:
            # It frees its buffer only when nothing is left over, which on a busy line is never
            del parser.buf[: parser.buf_index]
            parser.buf_index = 0
        return found

    def _count_garbage(self, size: int) -> None:
        self.counts["garbage_bytes"] += size
        self._garbage += size
        if self._garbage > MAX_GARBAGE_BYTES:
            raise HilError(
                f"{self._garbage} bytes came without one MAVLink message among them: is it PX4 "
                "that connected?"
            )

    def _word(self, kind: str, message: mav.MAVLink_message) -> Word | None:
        if kind == "HIL_ACTUATOR_CONTROLS":
            self.counts["controls"] += 1
            a, b, c, d = message.controls[:4]
            return Controls(
                message.time_usec,
                (a, b, c, d),
                bool(message.mode & mav.MAV_MODE_FLAG_SAFETY_ARMED),
                bool(message.flags & mav.HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP),
            )
        if kind == "COMMAND_LONG":
            self.counts["commands"] += 1
            # a float that is no message's number (NaN, too) is an unknown wish
            if message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL and message.param1 in _NUMBERS:
                return Interval(int(message.param1), message.param2)
            return Unknown(message.command)
        self.counts["heartbeats" if kind == "HEARTBEAT" else "others"] += 1
        return None


_NUMBERS = frozenset(float(number) for number in mav.mavlink_map)


def _new_parser() -> mav.MAVLink:
    mav.MAVLINK_IGNORE_CRC = 0  # no variable of the environment shall switch the checksum off
    parser = mav.MAVLink(None)
    parser.robust_parsing = True
    return parser
