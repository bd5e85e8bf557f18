"""A token bucket for how often something may happen."""

from __future__ import annotations


class Bucket:
    """Fills with ``rate_hz`` up to ``burst``.

    Args:
        rate_hz: tokens a second.
        burst: how many it holds; it is full at first.
        now_ns: own clock.
    """

    def __init__(self, rate_hz: float, burst: int, now_ns: int) -> None:
        self._rate_hz = rate_hz
        self._burst = float(burst)
        self._tokens = float(burst)
        self._filled_ns = now_ns

    def is_empty(self, now_ns: int) -> bool:
        """Not one token is left."""
        passed_ns = max(0, now_ns - self._filled_ns)
        self._filled_ns = max(now_ns, self._filled_ns)
        self._tokens = min(self._burst, self._tokens + passed_ns * self._rate_hz / 1e9)
        return self._tokens < 1

    def spend(self, tokens: int) -> None:
        """Take tokens; down to one burst of debt."""
        self._tokens = max(self._tokens - tokens, -self._burst)

    def take(self, now_ns: int) -> bool:
        """Take one token if there is one."""
        if self.is_empty(now_ns):
            return False
        self._tokens -= 1
        return True
