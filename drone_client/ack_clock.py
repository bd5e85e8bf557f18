"""The ack clock: at most W frames in the network, so that none waits in a hidden queue.

A queue between the drone and the worker (socket buffers, the radio, a router) holds frames that
age before anybody sees them. The drone therefore sends only while fewer than W frames are
unacknowledged; a receive-ack or a result frees a slot, a time-out frees it by force. W = 2 keeps
the link busy while one frame is being acknowledged; W = 1 is for overload.

Pure: no clock, no thread.
"""

from __future__ import annotations


class AckClock:
    """Frames in the network, by sequence, with the time each was sent [ns, drone's clock]."""

    def __init__(self, window: int, timeout_ns: int) -> None:
        if not 1 <= window <= 16:
            raise ValueError(f"a window is 1 to 16 frames, not {window}")
        if timeout_ns <= 0:
            raise ValueError(f"a time-out is positive, not {timeout_ns} ns")
        self._window = window
        self._timeout_ns = timeout_ns
        self._sent_ns: dict[int, int] = {}

    @property
    def in_flight(self) -> int:
        """Frames sent and not yet acknowledged, at most the window."""
        return len(self._sent_ns)

    def has_room(self) -> bool:
        """One more frame may be sent."""
        return len(self._sent_ns) < self._window

    def send(self, sequence: int, now_ns: int) -> None:
        """Take a slot; only while there is room."""
        if not self.has_room():
            raise ValueError(f"window of {self._window} is full")
        self._sent_ns[sequence] = now_ns

    def release(self, sequence: int) -> bool:
        """Free the frame's slot; False if it held none (late, repeated or made up)."""
        return self._sent_ns.pop(sequence, None) is not None

    def expire(self, now_ns: int) -> tuple[int, ...]:
        """Free the slots whose frames were never acknowledged in time, and name them."""
        late = tuple(s for s, t in self._sent_ns.items() if now_ns - t >= self._timeout_ns)
        for sequence in late:
            del self._sent_ns[sequence]
        return late
