"""A camera's own stamps on the drone's monotonic clock.

A camera stamps by its own crystal: from any zero, a little fast or slow, in 32-bit microseconds
that wrap after 71.6 minutes, and from zero again when it is plugged in anew. What the drone knows
is when a picture arrived. With O the true offset (drone's clock minus device's) and d the way of
a picture to us,

    arrival - stamp = O + d,   d >= d_min > 0,   O drifts by less than DRIFT

so every ``arrival - stamp + DRIFT x (time since then)`` is an upper bound of O + d_min now, and the
least of the last ten seconds is close to it: a lower envelope that may lean. The second least is
taken instead, so that one absurd stamp does not bend it. Then for every picture, with d_2 and a
the way and the age of the second best one in the window,

    0 <= mapped - (true + d_min) <= d_2 - d_min + 2 DRIFT a,   and mapped <= arrival.

d_min itself (read-out and transport at their quickest; a few milliseconds) cannot be known from
stamps: a picture is mapped that much too late, and never as fresher than its arrival.
"""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import dataclass
from typing import Final

DRIFT: Final = 100e-6
"""Two crystals differ by less than this: 100 millionths, 0.1 ms in a second."""
WINDOW_S: Final = 10
JUMP_NS: Final = 1_000_000_000
"""No driver holds pictures back for so long: further off is a stall, nonsense, or another zero."""
PATIENCE_NS: Final = 1_000_000_000
"""Nothing but odd stamps for so long: it is another zero."""
_SECOND_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Stamp:
    """One picture's stamp, understood."""

    t_device_ns: int
    """Device's clock without its wrap, from the first stamp's own zero."""
    jumped: bool = False
    """The device's clock has a new zero: what was stamped before it cannot be compared."""
    odd: bool = False
    """Over ``JUMP_NS`` beside the others: held up, nonsense, or the first of a new zero; when it
    was taken is not known."""


class ClockMap:
    """The offset between a device's clock and the drone's; pure, not thread-safe."""

    def __init__(self, *, tick_ns: int = 1000, wrap_bits: int | None = 32) -> None:
        """Nothing is known yet.

        Args:
            tick_ns: of the device's stamps.
            wrap_bits: width of its counter; None: it does not wrap.
        """
        self.jumps = 0
        self.odd = 0
        self._tick_ns = tick_ns
        self._wrap_ticks = None if wrap_bits is None else 1 << wrap_bits
        self._last_ticks: int | None = None
        self._last_device_ns = 0
        self._last_arrival_ns = 0
        self._odd_since_ns: int | None = None
        self._buckets: deque[tuple[int, list[int]]] = deque()
        """Second of arrival, and the two least ``arrival - stamp - DRIFT x arrival`` in it [ns]."""

    def reset(self) -> None:
        """The device was opened anew: its clock may have any zero."""
        self._last_ticks = None
        self._odd_since_ns = None
        self._buckets.clear()

    def see(self, stamp_ticks: int, t_arrival_ns: int) -> Stamp:
        """A picture has arrived.

        Args:
            stamp_ticks: as the device counts.
            t_arrival_ns: drone's clock; does not go back.
        """
        if self._last_ticks is None:
            t_device_ns = stamp_ticks * self._tick_ns
        else:
            t_device_ns = self._last_device_ns + self._step_ns(stamp_ticks, t_arrival_ns)
        offset_ns = t_arrival_ns - t_device_ns
        known_ns = self._offset_ns(t_arrival_ns)
        jumped = False
        if known_ns is not None and abs(offset_ns - known_ns) > JUMP_NS:
            if self._odd_since_ns is None:
                self._odd_since_ns = t_arrival_ns
            jumped = t_arrival_ns - self._odd_since_ns >= PATIENCE_NS
            if not jumped:
                self.odd += 1
                # Nothing is learnt from it: the next is again told from the last good one
                return Stamp(t_device_ns, odd=True)
            self.jumps += 1
            self._buckets.clear()
        self._odd_since_ns = None
        self._last_ticks = stamp_ticks
        self._last_device_ns = t_device_ns
        self._last_arrival_ns = t_arrival_ns
        self._note(offset_ns, t_arrival_ns)
        return Stamp(t_device_ns, jumped)

    def drone_from_device_ns(self, t_device_ns: int, t_arrival_ns: int) -> int:
        """A device's time on the drone's clock; never later than the arrival.

        Args:
            t_device_ns: of the exposure that arrived, such as ``Stamp.t_device_ns`` less half the
                exposure.
            t_arrival_ns: of that picture, drone's clock.
        """
        offset_ns = self._offset_ns(t_arrival_ns)
        if offset_ns is None:
            return t_arrival_ns
        return min(t_device_ns + offset_ns, t_arrival_ns)

    def device_from_drone_ns(self, t_drone_ns: int) -> int | None:
        """A time of the drone's clock on the device's; None: not known yet."""
        offset_ns = self._offset_ns(t_drone_ns)
        return None if offset_ns is None else t_drone_ns - offset_ns

    def _step_ns(self, stamp_ticks: int, t_arrival_ns: int) -> int:
        """Device's time since the last stamp: of all wraps the one that fits the arrivals."""
        assert self._last_ticks is not None
        step_ticks = stamp_ticks - self._last_ticks
        if self._wrap_ticks is not None:
            want_ticks = (t_arrival_ns - self._last_arrival_ns) // self._tick_ns
            wraps = (want_ticks - step_ticks + self._wrap_ticks // 2) // self._wrap_ticks
            step_ticks += wraps * self._wrap_ticks
        return step_ticks * self._tick_ns

    def _note(self, offset_ns: int, t_arrival_ns: int) -> None:
        second = t_arrival_ns // _SECOND_NS
        key = offset_ns - int(DRIFT * t_arrival_ns)
        if not self._buckets or self._buckets[-1][0] != second:
            self._buckets.append((second, []))
        least = self._buckets[-1][1]
        least.append(key)
        least.sort()
        del least[2:]
        while self._buckets[0][0] < second - WINDOW_S:
            self._buckets.popleft()

    def _offset_ns(self, now_ns: int) -> int | None:
        """Drone's clock minus device's, plus the least way of a picture; None: not known."""
        keys = heapq.nsmallest(2, (key for _, least in self._buckets for key in least))
        return keys[-1] + int(DRIFT * now_ns) if keys else None
