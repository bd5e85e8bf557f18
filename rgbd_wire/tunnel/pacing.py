"""How fast datagrams may leave: a token bucket that follows what the receiver saw arrive."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

PACKET_BYTES = 1228
"""A full datagram with its headers of UDP and IPv4."""
START_BPS = 50e6
MIN_BPS, MAX_BPS = 1e6, 10e9
GAIN = 1.25
"""Sends a little faster than the path was, so that a path that got better is found."""
REMEMBERED = 10
BURST_PACKETS = 8
BURST_NS = 1_000_000
MAX_LATE_NS = 20_000_000
"""What may be made up for at once; more would be a flood for a short queue on the way."""
CROWDED = 0.75


class Pacer:
    """A token bucket; its depth is 8 datagrams or what goes in 1 ms, whichever is more.

    Each report gives the rate at which a train of datagrams arrived, which on the way through a
    slow hop is the rate of that hop. The third largest of the last ten counts: one that came in one
    lump, because the receiver got no core for a while, does not open the flood gates.

    Whoever sends may come late, since it got no core itself. What it then sends at once is what it
    would have sent in time, so that the rate holds and the path carries no more for it.
    """

    def __init__(self, now_ns: int) -> None:
        self.rate_bps = START_BPS
        self.goodput_bps = 0.0
        """What the path carries as far as is known; 0: nothing yet."""
        self._samples = deque[float](maxlen=REMEMBERED)
        self._tokens = self.depth
        self._filled_ns = now_ns
        self._promised_ns: int | None = None
        self.late_ns = 0
        """How much later than ``ready_ns`` said the sender came the last time."""
        self._free_ns = now_ns
        self._last_message_ns: int | None = None
        self._busy = 0.0

    @property
    def depth(self) -> float:
        """Bytes that may leave at once."""
        return max(BURST_PACKETS * PACKET_BYTES, self.rate_bps / 8 * BURST_NS / 1e9)

    @property
    def crowded(self) -> bool:
        """The messages of late fill the path nearly up."""
        return self._busy > CROWDED

    def packets(self, now_ns: int) -> int:
        """How many datagrams may leave now."""
        passed_ns = max(0, now_ns - self._filled_ns)
        if passed_ns:
            promised_ns, self._promised_ns = self._promised_ns, None
            self.late_ns = 0 if promised_ns is None else max(0, now_ns - promised_ns)
            self._filled_ns = now_ns
            made_up = min(self.late_ns, MAX_LATE_NS) * self.rate_bps / 8e9
            filled = self._tokens + passed_ns * self.rate_bps / 8e9
            self._tokens = min(self.depth + made_up, filled)
        return max(0, int(self._tokens // PACKET_BYTES))

    def spend(self, packets: int) -> None:
        """Datagrams left; urgent ones may overdraw a little."""
        self._tokens = max(self._tokens - packets * PACKET_BYTES, -self.depth)
        if self.goodput_bps:
            carries_ns = int(packets * PACKET_BYTES * 8e9 / self.goodput_bps)
            self._free_ns = max(self._free_ns, self._filled_ns) + carries_ns

    def ready_ns(self, packets: int, not_before_ns: int = 0) -> int:
        """When half a burst, or all of fewer ``packets``, may leave; who comes later is late."""
        wanted = max(1, min(packets, int(self.depth / PACKET_BYTES) // 2)) * PACKET_BYTES
        lacking = max(0.0, wanted - self._tokens)
        ready_ns = self._filled_ns + int(lacking * 8e9 / self.rate_bps) + 1
        self._promised_ns = max(ready_ns, not_before_ns)
        return self._promised_ns

    def nothing_waits(self) -> None:
        """There is nothing to send: who comes next is not late."""
        self._promised_ns = None

    def is_path_free(self, now_ns: int) -> bool:
        """All that was sent so far should have passed the path's narrowest hop."""
        return now_ns >= self._free_ns

    def on_message(self, packets: int, now_ns: int) -> None:
        """A message was handed in: how full the path is."""
        if self._last_message_ns is not None and self.goodput_bps:
            apart_ns = max(1, now_ns - self._last_message_ns)
            busy = packets * PACKET_BYTES * 8e9 / self.goodput_bps / apart_ns
            self._busy += (min(busy, 2.0) - self._busy) / 8
        self._last_message_ns = now_ns

    def on_report(
        self,
        packets: int,
        train_bytes: int,
        train_us: int,
        restarts: Sequence[tuple[int, int]] = (),
    ) -> None:
        """A train of datagrams arrived.

        After a pause of the sender's own, the path has a new beginning: what left from then on,
        over the time that it took to arrive, is no more than the path's rate, and exactly that if
        nothing waited on the way. So the largest of these rates is the path's; that of the whole
        train would be the sender's.

        Args:
            packets: how many there were.
            train_bytes: how much of it came after the first batch.
            train_us: how long after it the last of it came.
            restarts: where the sender paused: how long after the first datagram it went on [us],
                and how many datagrams it sent from there to the end of the train.
        """
        fastest = 2 * self.rate_bps
        if train_us == 0 or 4 * train_bytes < packets * PACKET_BYTES:
            sample = fastest  # nearly all at once, faster than one can measure: probe
        else:
            sample = min(train_bytes * 8e6 / train_us, fastest)
        for after_us, rest in restarts:
            if rest >= BURST_PACKETS:
                took_us = max(train_us - after_us, 1)
                sample = max(sample, min((rest - 1) * PACKET_BYTES * 8e6 / took_us, fastest))
        self._samples.append(sample)
        ordered = sorted(self._samples, reverse=True)
        self.goodput_bps = min(ordered[min(2, (len(ordered) - 1) // 2)], MAX_BPS)
        self.rate_bps = min(max(GAIN * self.goodput_bps, MIN_BPS), MAX_BPS)
