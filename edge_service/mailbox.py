"""One slot per drone, newest wins: what stands between the network and the worker.

A queue would make every drone wait for frames that are of no use any more. Here a newer frame of a
drone takes the place of its older one, and the drones take turns.

Every frame passes ``admit``, which says at once what becomes of it, and if it was admitted ``put``.
A frame that was put is given out by ``take`` or returned by a later ``put`` or by ``empty``:
exactly once, by exactly one of them, so that each can be answered exactly once.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from rgbd_wire.frame_codec import PackedFrame
from rgbd_wire.messages import FrameHeader

WINDOW = 64
"""How many sequences back a late frame is told from a repeated one."""


class Verdict(Enum):
    """What becomes of a frame that has come in."""

    ADMITTED = auto()
    """Put it."""
    REPEATED = auto()
    """It has come in before, or is too old to tell: do not answer it again."""
    OUTDATED = auto()
    """A newer frame of the same drone has come before it, or takes its place."""
    NO_ROOM = auto()
    """It is of one drone too many."""
    CLOSED = auto()
    """No frames are taken any more."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A frame that has come in."""

    packed: PackedFrame
    t2_ns: int
    """Its last byte at the socket, worker's clock."""
    is_try: bool = False
    """Served even though it should be late; see ``edge_service.deadline``."""

    @property
    def drone(self) -> str:
        """Who sent it."""
        return self.packed.header.drone

    @property
    def deadline_ns(self) -> int:
        """When its budget is over, worker's clock."""
        return self.t2_ns + self.packed.header.budget_ns


class _Boot:
    """Which sequences of one start of a drone's client have come in."""

    __slots__ = ("boot_id", "highest", "seen")

    def __init__(self, boot_id: int) -> None:
        self.boot_id = boot_id
        self.highest = -1
        self.seen = 0
        """Bit n: sequence ``highest - n`` has come in."""

    def note(self, sequence: int) -> Verdict:
        """Remember a sequence, and say whether it is newer, older or known."""
        back = self.highest - sequence
        if back < 0:
            self.seen = 1 if -back >= WINDOW else (self.seen << -back | 1) & ((1 << WINDOW) - 1)
            self.highest = sequence
            return Verdict.ADMITTED
        if back >= WINDOW or self.seen >> back & 1:
            return Verdict.REPEATED
        self.seen |= 1 << back
        return Verdict.OUTDATED


class _Slot:
    """A drone's slot and what its client has sent so far."""

    __slots__ = ("boot", "last_ns", "previous", "waiting")

    def __init__(self, boot_id: int, now_ns: int) -> None:
        self.boot = _Boot(boot_id)
        self.previous: _Boot | None = None
        """Before the client was started anew; what is still on its way from there is outdated."""
        self.waiting: Arrival | None = None
        self.last_ns = now_ns

    def note(self, boot_id: int, sequence: int) -> Verdict:
        """Remember a sequence of either start; a start that is new takes the place of the other."""
        if self.previous is not None and boot_id == self.previous.boot_id:
            late = self.previous.note(sequence)
            return Verdict.REPEATED if late is Verdict.REPEATED else Verdict.OUTDATED
        if boot_id != self.boot.boot_id:
            self.previous, self.boot = self.boot, _Boot(boot_id)
        return self.boot.note(sequence)


class Mailbox:
    """Slots of at most ``max_drones`` drones; a silent one's is given to a new one.

    Of a drone that has no slot nothing is remembered, not even that its frame has come before.
    """

    def __init__(self, max_drones: int, idle_ns: int) -> None:
        self._max_drones = max_drones
        self._idle_ns = idle_ns
        self._changed = threading.Condition()
        self._slots: OrderedDict[str, _Slot] = OrderedDict()  # longest silent first
        self._turns: OrderedDict[str, None] = OrderedDict()  # drones with a frame, next one first
        self._closed = False

    @property
    def drones(self) -> int:
        """How many drones have a slot."""
        return len(self._slots)

    @property
    def waiting(self) -> int:
        """How many frames wait."""
        return len(self._turns)

    @property
    def finished(self) -> bool:
        """Closed and empty."""
        with self._changed:
            return self._closed and not self._turns

    def admit(self, header: FrameHeader, now_ns: int) -> Verdict:
        """Say what becomes of a frame, and remember that it has come in."""
        with self._changed:
            slot = self._slots.get(header.drone)
            if slot is not None and slot.waiting is None and self._is_idle(slot, now_ns):
                del self._slots[header.drone]
                slot = None
            if slot is None:
                if self._closed:
                    return Verdict.CLOSED
                if not self._make_room(now_ns):
                    return Verdict.NO_ROOM
                slot = self._slots[header.drone] = _Slot(header.boot_id, now_ns)
            verdict = slot.note(header.boot_id, header.sequence)
            if verdict is not Verdict.REPEATED and self._closed:
                return Verdict.CLOSED
            if verdict is Verdict.ADMITTED:
                slot.last_ns = now_ns
                self._slots.move_to_end(header.drone)
            return verdict

    def put(self, arrival: Arrival) -> tuple[Arrival, Verdict] | None:
        """Put an admitted frame into its drone's slot.

        Returns:
            The frame that this leaves without a place, and why: the older one, or this one itself
            when a newer one was faster or the mailbox has been closed since. None: all have one.
        """
        header = arrival.packed.header
        with self._changed:
            slot = self._slots.get(header.drone)
            if self._closed:
                return arrival, Verdict.CLOSED
            if slot is None or slot.boot.boot_id != header.boot_id:
                return arrival, Verdict.OUTDATED
            older = slot.waiting
            if older is not None and _is_newer(older.packed.header, header):
                return arrival, Verdict.OUTDATED
            slot.waiting = arrival
            self._turns.setdefault(header.drone)
            self._changed.notify()
            return None if older is None else (older, Verdict.OUTDATED)

    def take(
        self, timeout_s: float, accept: Callable[[Arrival], bool] | None = None
    ) -> Arrival | None:
        """The frame of the drone whose turn it is; None: none within the time, or closed.

        Args:
            timeout_s: how long to wait for one.
            accept: says which frames may be taken; the others keep their turns. It is called with
                the mailbox locked, so it must be quick and not call back.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._turn(accept) or self._closed, timeout_s)
            drone = self._turn(accept)
            return None if drone is None else self._give_out(drone)

    def close(self) -> None:
        """Take no more frames; those that wait are still given out."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def empty(self) -> list[Arrival]:
        """Give out all that wait at once."""
        with self._changed:
            return [self._give_out(drone) for drone in tuple(self._turns)]

    def _turn(self, accept: Callable[[Arrival], bool] | None) -> str | None:
        """The first drone in turn whose frame may be taken."""
        for drone in self._turns:
            waiting = self._slots[drone].waiting
            assert waiting is not None, "only drones with a frame have a turn"
            if accept is None or accept(waiting):
                return drone
        return None

    def _give_out(self, drone: str) -> Arrival:
        del self._turns[drone]
        slot = self._slots[drone]
        arrival, slot.waiting = slot.waiting, None
        assert arrival is not None, "only drones with a frame have a turn"
        return arrival

    def _is_idle(self, slot: _Slot, now_ns: int) -> bool:
        return now_ns - slot.last_ns > self._idle_ns

    def _make_room(self, now_ns: int) -> bool:
        """Whether a new drone has room, once the longest silent one has made way for it."""
        if len(self._slots) < self._max_drones:
            return True
        drone, slot = next(iter(self._slots.items()))
        if slot.waiting is not None or not self._is_idle(slot, now_ns):
            return False
        del self._slots[drone]
        return True


def _is_newer(header: FrameHeader, than: FrameHeader) -> bool:
    return header.boot_id == than.boot_id and header.sequence > than.sequence
