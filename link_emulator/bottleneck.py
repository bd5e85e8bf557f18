"""A serial line behind a bounded drop-tail queue.

Nothing is stored: what waits is known from when the line will be free.
"""

from __future__ import annotations

REFUSED = -1


class Bottleneck:
    """One packet after the other, at a rate.

    Args:
        rate_bit_s: of the line; None: every packet is through at once.
        queue_bytes: what may wait or be on the line beside the packet that comes; None: no bound.
            A packet that finds the line free is always taken, however large it is.
    """

    def __init__(self, rate_bit_s: float | None, queue_bytes: float | None) -> None:
        self._ns_per_byte = 0.0 if rate_bit_s is None else 8e9 / rate_bit_s
        self._queue_ns = float("inf") if queue_bytes is None else queue_bytes * self._ns_per_byte
        self._free_ns = 0.0

    @property
    def free_ns(self) -> float:
        """When the line will be free."""
        return self._free_ns

    def waits_until(self, free_ns: float) -> None:
        """Take over what another line had still to send: the rate was changed."""
        self._free_ns = free_ns

    def backlog_bytes(self, now_ns: int) -> float:
        """What waits or is on the line now."""
        if not self._ns_per_byte:
            return 0.0
        return max(0.0, self._free_ns - now_ns) / self._ns_per_byte

    def offer(self, now_ns: int, size_bytes: int) -> float:
        """When the packet's last byte is through, or ``REFUSED``: the queue is full."""
        free_ns = self._free_ns
        through_ns = size_bytes * self._ns_per_byte
        if free_ns <= now_ns:
            free_ns = float(now_ns)
        elif free_ns + through_ns - now_ns > self._queue_ns:
            return REFUSED
        self._free_ns = free_ns + through_ns
        return self._free_ns
