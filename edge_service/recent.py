"""Quantiles of the last few of many durations."""

from __future__ import annotations

import threading
from collections import deque


class Recent:
    """Keeps the last ``size`` durations, from any thread."""

    def __init__(self, size: int = 128) -> None:
        self._last: deque[int] = deque(maxlen=size)
        self._lock = threading.Lock()

    def note(self, spent_ns: int) -> None:
        """Keep one."""
        with self._lock:
            self._last.append(spent_ns)

    def quantile_ns(self, *shares: float) -> tuple[int, ...]:
        """For each share in [0, 1] the smallest kept duration that so many do not exceed; 0: none.

        All are of the same moment.
        """
        with self._lock:
            kept = sorted(self._last)
        if not kept:
            return (0,) * len(shares)
        return tuple(kept[min(int(share * len(kept)), len(kept) - 1)] for share in shares)
