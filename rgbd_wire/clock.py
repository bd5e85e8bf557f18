"""Time: integer nanoseconds of one machine's monotonic clock, asked from a ``Clock``."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Gives the time of the machine that it runs on; never compared across machines."""

    def now_ns(self) -> int:
        """Monotonic time [ns], with an arbitrary zero."""
        ...


class MonotonicClock:
    """The machine's own monotonic clock."""

    def now_ns(self) -> int:
        """Monotonic time [ns]."""
        return time.monotonic_ns()


class ManualClock:
    """A clock that stands still until it is moved; what tests and lockstep runs use."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """The time it was last moved to [ns]."""
        return self._now_ns

    def advance(self, step_ns: int) -> None:
        """Move forward by ``step_ns`` >= 0."""
        if step_ns < 0:
            raise ValueError(f"a monotonic clock does not go back: {step_ns} ns")
        self._now_ns += step_ns
