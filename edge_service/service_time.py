"""How long a frame is expected to take once the worker has it, from those that it had of late.

A median, for one slow frame says nothing of the next, and only of what is fresh: a figure that
turned frames away for ever would never be measured again.
"""

from __future__ import annotations

import threading
from collections import deque

WINDOW = 32
"""Samples kept for each size of batch."""
FRESH_NS = 2_000_000_000
"""What is older says nothing of the load as it is now."""


class ServiceTime:
    """Expected time by size of batch; from any thread. All times are of the worker's clock."""

    def __init__(self) -> None:
        self._samples: dict[int, deque[tuple[int, int]]] = {}
        self._lock = threading.Lock()

    def note(self, size: int, spent_ns: int, now_ns: int) -> None:
        """A batch of ``size`` frames took ``spent_ns``, from its taking to its last answer."""
        with self._lock:
            window = self._samples.setdefault(size, deque(maxlen=WINDOW))
            window.append((now_ns, spent_ns))

    def expected_ns(self, now_ns: int, size: int = 1) -> int:
        """What a batch of ``size`` would take now; 0: nobody knows.

        It never falls with the size. A size of which there is no fresh sample is taken to cost as
        much for each frame as the next smaller one, but no more than the next larger one.
        """
        with self._lock:
            medians = {
                known: spent_ns
                for known in sorted(self._samples)
                if (spent_ns := _fresh_median(self._samples[known], now_ns)) is not None
            }
        below_ns, at = 0, 0
        for known, spent_ns in medians.items():
            if known <= size:
                below_ns, at = max(below_ns, spent_ns), known
        if at == size:
            return below_ns
        larger_ns = next((ns for known, ns in medians.items() if known > size), None)
        if at == 0:
            return larger_ns or 0
        scaled_ns = below_ns * size // at
        return scaled_ns if larger_ns is None else min(scaled_ns, max(larger_ns, below_ns))


def _fresh_median(samples: deque[tuple[int, int]], now_ns: int) -> int | None:
    """The lower median, so that of two the kinder one counts."""
    fresh = sorted(spent_ns for at_ns, spent_ns in samples if now_ns - at_ns <= FRESH_NS)
    return fresh[(len(fresh) - 1) // 2] if fresh else None
