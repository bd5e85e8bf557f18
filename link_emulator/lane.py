"""Packets under way in one direction: what a path decided, kept until it is due."""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush
from typing import Generic, TypeVar

from link_emulator.histogram import Histogram
from link_emulator.path import Drop, Path
from link_emulator.report import DirectionReport

NEVER_NS = 1 << 62
MAX_WAITING = 500_000
"""A link of great delay and no rate would take all memory; what is past this is not sent."""
Packet = TypeVar("Packet")


class Lane(Generic[Packet]):
    """One direction of a relay.

    Args:
        path: decides.
        emit: sends a packet on; False: it could not be.
        now_ns: the clock.
    """

    def __init__(
        self, path: Path, emit: Callable[[Packet], bool], now_ns: Callable[[], int]
    ) -> None:
        self.path = path
        self.next_ns = NEVER_NS
        """When the next packet is due."""
        self.errors = Histogram()
        self._emit = emit
        self._now_ns = now_ns
        self._waiting: list[tuple[int, int, int, Packet]] = []
        self._number = 0
        self._passed = 0
        self._passed_bytes = 0
        self._dropped = dict.fromkeys(Drop, 0)
        self._not_sent = 0

    def offer(self, packet: Packet, size_bytes: int, now_ns: int) -> None:
        """A packet has come in."""
        release_ns = self.path.offer(now_ns, size_bytes)
        if release_ns < 0:
            self._dropped[Drop(release_ns)] += 1
            return
        if len(self._waiting) >= MAX_WAITING:
            self._not_sent += 1
            return
        # The number keeps packets of one time in order, and the heap from comparing packets
        self._number = number = self._number + 1
        heappush(self._waiting, (release_ns, number, size_bytes, packet))
        self.next_ns = self._waiting[0][0]

    def release(self, now_ns: int, at_most: int) -> int:
        """Send what is due, at most so many, and give how many it were."""
        waiting = self._waiting
        for count in range(at_most):
            if not waiting or waiting[0][0] > now_ns:
                return count
            release_ns, _, size_bytes, packet = heappop(waiting)
            self.next_ns = waiting[0][0] if waiting else NEVER_NS
            if self.path.is_cut(release_ns):
                self._dropped[Drop.CUT] += 1
            elif self._emit(packet):
                now_ns = self._now_ns()
                self.errors.add(now_ns - release_ns)
                self._passed += 1
                self._passed_bytes += size_bytes
            else:
                self._not_sent += 1
        return at_most

    def report(self) -> DirectionReport:
        """What became of the packets."""
        dropped = {reason.name.lower(): count for reason, count in self._dropped.items()}
        return DirectionReport(
            self._passed,
            self._passed_bytes,
            dropped | {"not_sent": self._not_sent},
            len(self._waiting),
        )

    def reset(self) -> None:
        """Count from zero; what is under way stays so."""
        self.errors = Histogram()
        self._passed = self._passed_bytes = self._not_sent = 0
        self._dropped = dict.fromkeys(Drop, 0)
