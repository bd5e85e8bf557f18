"""How late packets left, in bounded memory: one bucket a microsecond."""

from __future__ import annotations

import math

BUCKETS = 20_000
"""Up to 20 ms; what is later falls into the last one, and the maximum is kept exactly."""


class Histogram:
    """Counts durations that are not negative."""

    def __init__(self) -> None:
        self._counts = [0] * (BUCKETS + 1)
        self._max_ns = 0
        self.total = 0

    @property
    def max_ns(self) -> int:
        """The longest one, exactly."""
        return self._max_ns

    def add(self, duration_ns: int) -> None:
        """Count one."""
        bucket = duration_ns // 1000
        self._counts[bucket if bucket < BUCKETS else BUCKETS] += 1
        self.total += 1
        if duration_ns > self._max_ns:
            self._max_ns = duration_ns

    def merge(self, other: Histogram) -> None:
        """Count all of another one, too."""
        for bucket, count in enumerate(other._counts):
            if count:
                self._counts[bucket] += count
        self.total += other.total
        self._max_ns = max(self._max_ns, other._max_ns)

    def quantile_ns(self, q: float) -> int:
        """Upper edge of the bucket that holds the quantile, at most the maximum; 0 when empty."""
        rank = max(1, math.ceil(q * self.total))
        seen = 0
        for bucket, count in enumerate(self._counts):
            seen += count
            if count and seen >= rank:
                return self._max_ns if bucket == BUCKETS else min(self._max_ns, 1000 * (bucket + 1))
        return 0
