"""The one table of streams: key, rate, age, size, priority. Both ends read it; nobody retypes it.

Keys carry the protocol's version and are directed, so that no wildcard stands on the hot path of
the drone and a worker subscribes to its own name alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

PREFIX = "aerial/v1"


class Urgency(StrEnum):
    """How a transport ranks a stream against the others."""

    DATA = "data"
    """Behind everything urgent; dropped first."""
    REAL_TIME = "real_time"
    """Small and urgent: sent at once, never batched."""


@dataclass(frozen=True, slots=True)
class Stream:
    """One stream between a drone and a worker."""

    name: str
    rate_hz: float
    """What a drone sends or gets at most."""
    max_age_ms: float
    """From capture; what is older is of no use."""
    urgency: Urgency

    def key(self, drone: str, worker: str) -> str:
        """The Zenoh key; ``*`` stands for any drone or worker."""
        return f"{PREFIX}/{drone}/{self.name}/{worker}"


FRAME = Stream("frame", rate_hz=30.0, max_age_ms=250.0, urgency=Urgency.DATA)
RESULT = Stream("result", rate_hz=60.0, max_age_ms=300.0, urgency=Urgency.REAL_TIME)
"""Results and receive-acks, in one stream so that an ack never arrives after its result; and the
echoes of probes."""
PROBE = Stream("probe", rate_hz=15.0, max_age_ms=250.0, urgency=Urgency.REAL_TIME)
STATUS_RATE_HZ = 5.0
"""How often a worker says how it is; at once when it begins to drain."""


def worker_key(worker: str) -> str:
    """Key of a worker's liveliness token; ``*`` stands for any."""
    return f"{PREFIX}/workers/{worker}"


def worker_status_key(worker: str) -> str:
    """Key of a worker's status; ``*`` stands for any."""
    return f"{worker_key(worker)}/status"


def drone_of_key(key: str) -> str:
    """Name of the drone in the key of a directed stream."""
    return key.split("/", 3)[2]


def worker_of_key(key: str) -> str:
    """Name of the worker in the last chunk of a key."""
    return key.rsplit("/", 1)[-1]
