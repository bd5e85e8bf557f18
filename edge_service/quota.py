"""How often each drone may send: one that floods costs the others next to nothing.

The network says who a message is from, so the ruling needs no look into it.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from enum import Enum, auto

from rgbd_wire.tunnel.bucket import Bucket


class Pace(Enum):
    """How a message's drone keeps to its rate."""

    FINE = auto()
    TOO_FAST = auto()
    """Over its rate: worth a word back."""
    FLOOD = auto()
    """Over twice its rate: not worth a look."""


class Quotas:
    """The rates of the drones heard last, from any thread.

    Args:
        rate_hz: what each may send; a quarter of a second's worth, and at least 8, may come at
            once.
        max_drones: how many are remembered; whoever was forgotten starts over with a full quota.
    """

    def __init__(self, rate_hz: float, max_drones: int) -> None:
        self._rate_hz = rate_hz
        self._burst = max(8, int(rate_hz / 4))
        self._max_drones = max_drones
        self._buckets: OrderedDict[str, tuple[Bucket, Bucket]] = OrderedDict()
        self._lock = threading.Lock()

    def pace(self, drone: str, now_ns: int) -> Pace:
        """Count one message of a drone that came at ``now_ns``, worker's clock."""
        with self._lock:
            buckets = self._buckets.get(drone)
            if buckets is None:
                buckets = self._bucket(now_ns), self._bucket(now_ns)
                self._buckets[drone] = buckets
                if len(self._buckets) > self._max_drones:
                    self._buckets.popitem(last=False)
            else:
                self._buckets.move_to_end(drone)
            accepted, told = buckets
            if accepted.take(now_ns):
                return Pace.FINE
            return Pace.TOO_FAST if told.take(now_ns) else Pace.FLOOD

    def __len__(self) -> int:
        """How many drones are remembered."""
        return len(self._buckets)

    def _bucket(self, now_ns: int) -> Bucket:
        return Bucket(self._rate_hz, self._burst, now_ns)
