"""When the next frame may leave: the ack clock, and a departure time on top of it.

The window alone keeps a hidden queue from growing past W frames. A second frame that is sent at
once, though, waits out the whole serialisation of the first in the link's queue, and ages there
instead of being replaced by a newer one on board. So it leaves only when what is under way will
be through by the time it gets there: the link never idles, and nothing queues in it. That is the
bandwidth-delay idea of BBR (Cardwell et al., 2016) with frames for packets.

Pure: no clock, no thread.
"""

from __future__ import annotations

from drone_client.ack_clock import AckClock

LEAD_SHARE = 0.1
"""Of a frame's predicted serialisation: so much earlier than needed the next one leaves. An error
of the prediction then costs a little age, and not an idle link."""
MIN_LEAD_NS = 2_000_000


class Departures:
    """Frames under way by sequence, and when the link will be through with them."""

    def __init__(self, window: int, timeout_ns: int) -> None:
        self._acks = AckClock(window, timeout_ns)
        self._serialisation_ns: dict[int, int] = {}
        """Predicted for each frame under way, oldest first."""
        self._workers: dict[int, str] = {}
        """Whom each of them went to."""
        self._free_ns = 0
        """A frame sent at this time would meet a link that has just become free: the link's
        future, shifted back by the way to it."""
        self._lead_ns = 0

    @property
    def in_flight(self) -> int:
        """Frames sent and not yet acknowledged."""
        return self._acks.in_flight

    def wait_ns(self, now_ns: int, preparation_ns: int = 0) -> int | None:
        """How long until a frame may leave; None: not before an ack or a time-out.

        Args:
            now_ns: drone's clock.
            preparation_ns: what lies between this decision and the first byte: encoding.
        """
        if not self._acks.has_room():
            return None
        if not self._acks.in_flight:
            return 0
        return max(0, self._free_ns - self._lead_ns - preparation_ns - now_ns)

    def send(self, sequence: int, worker: str, now_ns: int, serialisation_ns: int) -> None:
        """A frame leaves; the link is predicted to be busy with it for so long."""
        self._acks.send(sequence, now_ns)
        self._workers[sequence] = worker
        self._serialisation_ns[sequence] = serialisation_ns
        self._free_ns = max(self._free_ns, now_ns) + serialisation_ns
        self._lead_ns = max(MIN_LEAD_NS, round(LEAD_SHARE * serialisation_ns))

    def release(self, sequence: int, now_ns: int, round_trip_ns: int) -> bool:
        """An ack came: free the frame's slot and its worker's older ones; set the prediction right.

        Frames reach a worker in the order in which they left, and one that is repaired late is
        dropped for a newer one that is whole. So an older frame without an ack is lost, or its ack
        is: waiting for a time-out would only hold its slot.

        Args:
            sequence: the frame's.
            now_ns: drone's clock.
            round_trip_ns: of an empty link; the ack left the link's far end that long after the
                link was through with the frame, both ways counted.

        Returns:
            False if it held no slot (late, repeated or made up).
        """
        if not self._acks.release(sequence):
            return False
        del self._serialisation_ns[sequence]
        worker = self._workers.pop(sequence)
        for older in [s for s, w in self._workers.items() if s < sequence and w == worker]:
            self.forget(older)
        self._free_ns = now_ns - round_trip_ns + sum(self._serialisation_ns.values())
        return True

    def forget(self, sequence: int) -> None:
        """A frame will not be acknowledged, and whoever has it is no more: free its slot."""
        if self._acks.release(sequence):
            del self._serialisation_ns[sequence], self._workers[sequence]

    def expire(self, now_ns: int) -> tuple[int, ...]:
        """Free the slots whose frames were never acknowledged in time, and name them."""
        late = self._acks.expire(now_ns)
        for sequence in late:
            del self._serialisation_ns[sequence], self._workers[sequence]
        return late
