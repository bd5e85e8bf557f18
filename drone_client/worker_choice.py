"""Which worker a drone would go to: rendezvous hashing, weighted by what the drone measured.

Each drone ranks all workers by a hash of both names (Thaler and Ravishankar, "Using name-based
mappings to increase hit rates", 1998): drones spread over the workers without anybody deciding,
and a worker that goes moves only its own drones. Weights as in Schindelhauer and Schomaker,
"Weighted distributed hash tables", 2005: twice the weight, twice the drones.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping


def rendezvous_score(drone: str, worker: str, weight: float = 1.0) -> float:
    """Rank of a worker for a drone: the same on every machine, highest first; ``weight`` > 0."""
    digest = hashlib.blake2b(f"{drone}/{worker}".encode(), digest_size=8).digest()
    uniform = (int.from_bytes(digest, "big") + 0.5) / 2**64  # in (0, 1)
    return weight / -math.log(uniform)


def ranked(drone: str, weights: Mapping[str, float]) -> list[str]:
    """All workers, best first; equal scores by name."""
    return sorted(
        weights, key=lambda worker: (-rendezvous_score(drone, worker, weights[worker]), worker)
    )
