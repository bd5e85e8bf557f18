"""Reads an autopilot's parameters by name, over a line that may lose messages; bounded in time."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Iterable

from pymavlink.dialects.v20 import common as mav

from rgbd_wire.clock import Clock

NAME_MAX = 16
ASK_AGAIN_S = 0.4
BATCH = 8
"""Asked for at once; a slow serial line has a queue."""

_INTEGERS = {
    mav.MAV_PARAM_TYPE_UINT8: "<B",
    mav.MAV_PARAM_TYPE_INT8: "<b",
    mav.MAV_PARAM_TYPE_UINT16: "<H",
    mav.MAV_PARAM_TYPE_INT16: "<h",
    mav.MAV_PARAM_TYPE_UINT32: "<I",
    mav.MAV_PARAM_TYPE_INT32: "<i",
}


class ParameterReader:
    """Questions by PARAM_REQUEST_READ, answers by PARAM_VALUE. One reading at a time."""

    def __init__(self, clock: Clock, ask: Callable[[str], None], *, bytewise: bool) -> None:
        """Take over the callbacks.

        Args:
            clock: the drone's.
            ask: sends a question for a name.
            bytewise: integers come as their bytes in the float's place (PX4), not as a float
                (ArduPilot).
        """
        self.bytewise = bytewise
        self._clock = clock
        self._ask = ask
        self._wanted: set[str] = set()
        self._values: dict[str, float | int] = {}
        self._changed = threading.Condition()
        self._one_at_a_time = threading.Lock()

    def read(self, names: Iterable[str], timeout_s: float) -> dict[str, float | int]:
        """Values by name; what does not come within the time is missing.

        Names that no autopilot can have are missing too.
        """
        wanted = list(dict.fromkeys(n for n in names if 0 < len(n) <= NAME_MAX and n.isascii()))
        end_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        with self._one_at_a_time, self._changed:
            self._wanted, self._values = set(wanted), {}
            asked = dict.fromkeys(wanted, 0)
            while len(self._values) < len(wanted) and self._clock.now_ns() < end_ns:
                missing = (n for n in wanted if n not in self._values)
                # Least asked first: some that are never answered keep nobody else from being asked
                batch = sorted(missing, key=lambda n: asked[n])[:BATCH]
                for name in batch:
                    asked[name] += 1
                    self._ask(name)
                left_s = (end_ns - self._clock.now_ns()) / 1e9
                self._changed.wait_for(
                    lambda: all(n in self._values for n in batch),  # noqa: B023  # used at once
                    max(0.0, min(left_s, ASK_AGAIN_S)),
                )
            self._wanted = set()
            return dict(self._values)

    def heard(self, message: mav.MAVLink_message) -> None:
        """Take a PARAM_VALUE; one that nobody asked for is not kept."""
        name = str(message.param_id)
        value = parameter_value(message.param_value, message.param_type, bytewise=self.bytewise)
        with self._changed:
            if name in self._wanted and value is not None:
                self._values[name] = value
                self._changed.notify_all()


def parameter_value(raw: float, kind: int, *, bytewise: bool) -> float | int | None:
    """The value in a PARAM_VALUE; None: of no kind that fits there.

    Args:
        raw: its ``param_value``.
        kind: its ``param_type``.
        bytewise: see ``ParameterReader``.
    """
    if kind == mav.MAV_PARAM_TYPE_REAL32:
        return float(raw)
    layout = _INTEGERS.get(kind)
    if layout is None:
        return None
    if bytewise:
        return int(struct.unpack_from(layout, struct.pack("<f", raw))[0])
    return round(raw) if abs(raw) < 2.0**31 else None
