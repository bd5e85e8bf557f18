"""Which worker serves this drone: rendezvous hashing over the live ones, and staying put.

Each drone ranks all workers by a hash of both names (Thaler and Ravishankar, "Using name-based
mappings to increase hit rates", 1998): drones spread over the workers without anybody deciding,
and a worker that goes moves only its own drones.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection


def rendezvous_score(drone: str, worker: str) -> int:
    """Rank of a worker for a drone: the same on every machine, highest first."""
    digest = hashlib.blake2b(f"{drone}/{worker}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big")


def choose_worker(
    drone: str, live: Collection[str], current: str | None, avoid: Collection[str] = ()
) -> str | None:
    """The worker to send to; None if none is alive.

    The current one as long as it lives and is not to be avoided: a change of worker costs frames.
    One to be avoided is taken only where there is no other.
    """
    willing = [w for w in live if w not in avoid] or list(live)
    if not willing:
        return None
    if current in willing:
        return current
    return max(willing, key=lambda worker: rendezvous_score(drone, worker))
