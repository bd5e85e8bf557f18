"""What the link carries, in bytes a second, from the acks of frames; any transport.

A frame that was sent at t1 and acknowledged at t_ack kept the link busy from the later of t1 and
the ack before it, until t_ack; the empty link's round trip is no part of that. Bytes over that
time is a sample of the goodput, as BBR's delivery rate is (Cheng et al., draft-cheng-iccrg-
delivery-rate-estimation). A frame on a fast link is through before anything can be told: then the
sample is a lower bound, and large.

Two windows: the median of the last three samples follows a fall within three frames, and the
estimate rises only with the median of the last seven, so that one lucky ack does not fill a queue.
A frame that times out is an upper bound, taken at once and kept until the next ack.

Pure: no clock, no thread.
"""

from __future__ import annotations

from collections import deque
from statistics import median

FALL_SAMPLES = 3
RISE_SAMPLES = 7
SHORTEST_NS = 200_000
"""What an ack's own jitter is on a good day: no serialisation is told more finely."""
LARGEST_BYTES_PER_S = 1.25e9
"""10 Gbit/s: a frame every 0.1 ms; past it a number means nothing here."""


class Goodput:
    """Estimate over the acks of one drone's link."""

    def __init__(self) -> None:
        self._samples: deque[float] = deque(maxlen=RISE_SAMPLES)
        self._last_ack_ns: int | None = None
        self._ceiling: float | None = None
        """The link carries no more than this, by a frame that timed out since the last ack."""

    @property
    def bytes_per_s(self) -> float | None:
        """The estimate; None before the first ack or time-out."""
        if self._ceiling is not None:
            return self._ceiling
        if not self._samples:
            return None
        lately = median(list(self._samples)[-FALL_SAMPLES:])
        return min(lately, median(self._samples)) if len(self._samples) > FALL_SAMPLES else lately

    def acked(self, size_bytes: int, t1_ns: int, t_ack_ns: int, round_trip_ns: int) -> None:
        """A frame's ack came, and it was the first sign of that frame.

        Args:
            size_bytes: of the whole message.
            t1_ns: when it was handed to the link, drone's clock.
            t_ack_ns: when the ack was here, drone's clock.
            round_trip_ns: of a small message on the empty link; 0 if nobody knows.
        """
        last_ns, self._last_ack_ns = self._last_ack_ns, t_ack_ns
        begun_ns = t1_ns + max(0, round_trip_ns)
        if last_ns is not None:
            begun_ns = max(begun_ns, last_ns)
        busy_ns = max(SHORTEST_NS, t_ack_ns - begun_ns)
        if self._ceiling is not None:
            self._samples.clear()  # they are of a link that is no more
            self._ceiling = None
        self._samples.append(min(size_bytes * 1e9 / busy_ns, LARGEST_BYTES_PER_S))

    def timed_out(self, size_bytes: int, t1_ns: int, now_ns: int) -> None:
        """A frame was not acknowledged in time: silence, too, says how slow the link is.

        Without this, a link that became so slow that no ack comes in time would be thought to be
        as fast as it last was, for ever.

        Args:
            size_bytes: of the whole message.
            t1_ns: when it was handed to the link, drone's clock.
            now_ns: drone's clock.
        """
        begun_ns = t1_ns if self._last_ack_ns is None else max(t1_ns, self._last_ack_ns)
        bound = size_bytes * 1e9 / max(SHORTEST_NS, now_ns - begun_ns)
        known = self.bytes_per_s
        self._ceiling = min(bound, LARGEST_BYTES_PER_S if known is None else known)
