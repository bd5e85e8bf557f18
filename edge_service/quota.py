"""How often each drone may send: one that floods costs the others next to nothing.

The network says who a message is from, so the ruling needs no look into it.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from enum import Enum, auto

from rgbd_wire.tunnel.bucket import Bucket

FLOODED_NS = 1_000_000_000
"""For so long after its last message over twice the rate a drone counts as flooding."""
FLOODING_HZ = 1.0
"""What is taken of a drone that floods. Fair turns would not do: the worker would never be idle,
and every frame of the others would wait for one of this drone's to be done."""


class Pace(Enum):
    """How a message's drone keeps to its rate."""

    FINE = auto()
    TOO_FAST = auto()
    """Over its rate: worth a word back."""
    FLOOD = auto()
    """Over twice its rate: not worth a look."""


class _Rates:
    """What one drone has left; not for several threads."""

    __slots__ = ("_accepted", "_flooded_ns", "_flooding", "_told")

    def __init__(self, rate_hz: float, burst: int, now_ns: int) -> None:
        self._accepted = Bucket(rate_hz, burst, now_ns)
        self._told = Bucket(rate_hz, burst, now_ns)
        self._flooding = Bucket(FLOODING_HZ, 1, now_ns)
        self._flooded_ns: int | None = None
        """When it last went over twice the rate."""

    def pace(self, now_ns: int) -> Pace:
        flooded_ns = self._flooded_ns
        is_flooding = flooded_ns is not None and now_ns - flooded_ns < FLOODED_NS
        # Counted in any case, so that the end of a flood is no second burst
        within_rate = self._accepted.take(now_ns)
        if within_rate and (not is_flooding or self._flooding.take(now_ns)):
            return Pace.FINE
        if self._told.take(now_ns):
            return Pace.TOO_FAST
        self._flooded_ns = now_ns
        return Pace.FLOOD


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
        self._rates: OrderedDict[str, _Rates] = OrderedDict()  # longest silent first
        self._lock = threading.Lock()

    def pace(self, drone: str, now_ns: int) -> Pace:
        """Count one message of a drone that came at ``now_ns``, worker's clock."""
        with self._lock:
            rates = self._rates.get(drone)
            if rates is None:
                rates = self._rates[drone] = _Rates(self._rate_hz, self._burst, now_ns)
                if len(self._rates) > self._max_drones:
                    self._rates.popitem(last=False)
            else:
                self._rates.move_to_end(drone)
            return rates.pace(now_ns)

    def __len__(self) -> int:
        """How many drones are remembered."""
        return len(self._rates)
