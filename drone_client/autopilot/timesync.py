"""MAVLink's TIMESYNC: the autopilot's clock, as seen from the drone's.

Both ends answer the other's question: ``tc1 = 0`` asks, and the answer carries the asker's ``ts1``
back beside the answerer's time in ``tc1`` (nanoseconds since boot).

Whose clock a stamp is in that we send: **ours**. PX4 learns the offset of our clock from our
answers and maps the stamps that it gets (``time_usec`` of ODOMETRY) to its own; a stamp that is
mapped here would be mapped twice. What PX4 sends is in its clock, and is mapped here.
"""

from __future__ import annotations

from collections import deque

from drone_client.clock_offset import ClockOffset, Echo

MAX_ROUND_TRIP_NS = 200_000_000
MAX_STAMP_NS = 1 << 62
"""Beyond it a stamp is no time since a boot."""


class Timesync:
    """Offset of the autopilot's clock; not thread-safe."""

    def __init__(self) -> None:
        self.unused = 0
        """Answers to no question of ours, late ones, and impossible ones."""
        self._asked_ns: deque[int] = deque(maxlen=16)
        self._offset = ClockOffset()

    @property
    def steps(self) -> int:
        """Times that the autopilot's clock jumped: it was started anew."""
        return self._offset.steps

    def ask(self, now_ns: int) -> int:
        """The ``ts1`` of a question that leaves now [ns, drone's clock]."""
        self._asked_ns.append(now_ns)
        return now_ns

    def answered(self, tc1_ns: int, ts1_ns: int, now_ns: int) -> None:
        """Take an answer.

        Args:
            tc1_ns: autopilot's clock.
            ts1_ns: of our question, as it came back.
            now_ns: drone's clock.
        """
        plausible = 0 < tc1_ns < MAX_STAMP_NS and 0 <= now_ns - ts1_ns <= MAX_ROUND_TRIP_NS
        if not plausible or ts1_ns not in self._asked_ns:
            self.unused += 1
            return
        self._asked_ns.remove(ts1_ns)  # an answer that comes twice counts once
        self._offset.add(Echo(t1_ns=ts1_ns, t2_ns=tc1_ns, t3_ns=tc1_ns, t4_ns=now_ns))

    def ours_ns(self, theirs_ns: int, now_ns: int) -> int | None:
        """A time of the autopilot's clock on the drone's; None: not known yet."""
        estimate = self._offset.estimate(now_ns)
        return None if estimate is None else theirs_ns - estimate.offset_ns

    def offset_ns(self, now_ns: int) -> tuple[int, int] | None:
        """Autopilot's clock minus drone's clock, and its error bound [ns]; None: not known yet."""
        estimate = self._offset.estimate(now_ns)
        return None if estimate is None else (estimate.offset_ns, estimate.bound_ns)
