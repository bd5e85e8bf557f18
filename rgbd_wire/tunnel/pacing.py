"""How fast datagrams may leave: a token bucket that follows what the receiver saw arrive."""

from __future__ import annotations

from collections import deque

PACKET_BYTES = 1228
"""A full datagram with its headers of UDP and IPv4."""
START_BPS = 50e6
MIN_BPS, MAX_BPS = 1e6, 10e9
GAIN = 1.25
"""Sends a little faster than the path was, so that a path that got better is found."""
REMEMBERED = 10
BURST_PACKETS = 8
BURST_NS = 1_000_000
CROWDED = 0.75


class Pacer:
    """A token bucket; its depth is 8 datagrams or what goes in 1 ms, whichever is more.

    Each report gives the rate at which a train of datagrams arrived, which on the way through a
    slow hop is the rate of that hop. The third largest of the last ten counts: one that came in one
    lump, because the receiver got no core for a while, does not open the flood gates.
    """

    def __init__(self, now_ns: int) -> None:
        self.rate_bps = START_BPS
        self.goodput_bps = 0.0
        """What the path carries as far as is known; 0: nothing yet."""
        self._samples = deque[float](maxlen=REMEMBERED)
        self._tokens = self.depth
        self._filled_ns = now_ns
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
        self._filled_ns = max(now_ns, self._filled_ns)
        self._tokens = min(self.depth, self._tokens + passed_ns * self.rate_bps / 8e9)
        return max(0, int(self._tokens // PACKET_BYTES))

    def spend(self, packets: int) -> None:
        """Datagrams left; urgent ones may overdraw a little."""
        self._tokens = max(self._tokens - packets * PACKET_BYTES, -self.depth)

    def ready_ns(self, packets: int) -> int:
        """When half a burst, or all of fewer ``packets``, may leave."""
        wanted = max(1, min(packets, int(self.depth / PACKET_BYTES) // 2)) * PACKET_BYTES
        lacking = max(0.0, wanted - self._tokens)
        return self._filled_ns + int(lacking * 8e9 / self.rate_bps) + 1

    def on_message(self, packets: int, now_ns: int) -> None:
        """A message was handed in: how full the path is."""
        if self._last_message_ns is not None and self.goodput_bps:
            apart_ns = max(1, now_ns - self._last_message_ns)
            busy = packets * PACKET_BYTES * 8e9 / self.goodput_bps / apart_ns
            self._busy += (min(busy, 2.0) - self._busy) / 8
        self._last_message_ns = now_ns

    def on_report(self, packets: int, train_bytes: int, train_us: int) -> None:
        """A train of datagrams arrived.

        Args:
            packets: how many there were.
            train_bytes: how much of it came after the first batch.
            train_us: how long after it the last of it came.
        """
        if train_us == 0 or 4 * train_bytes < packets * PACKET_BYTES:
            sample = 2 * self.rate_bps  # nearly all at once, faster than one can measure: probe
        else:
            sample = min(train_bytes * 8e6 / train_us, 2 * self.rate_bps)
        self._samples.append(sample)
        ordered = sorted(self._samples, reverse=True)
        self.goodput_bps = min(ordered[min(2, (len(ordered) - 1) // 2)], MAX_BPS)
        self.rate_bps = min(max(GAIN * self.goodput_bps, MIN_BPS), MAX_BPS)
