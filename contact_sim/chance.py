"""One seed, many independent streams of random numbers.

Every part asks for a stream of its own by name, so that what one part draws never moves what
another one gets: the same seed is the same world, whichever sensors are on.
"""

from __future__ import annotations

import zlib

import numpy as np

from contact_sim.errors import WorldError

MAX_SEED = 2**63 - 1


def stream(seed: int, name: str) -> np.random.Generator:
    """The stream of a name, from its beginning.

    Raises:
        WorldError: the seed is negative or too large.
    """
    if not 0 <= seed <= MAX_SEED:
        raise WorldError(f"a seed is a whole number from 0 to {MAX_SEED}, not {seed}")
    return np.random.default_rng(np.random.SeedSequence((seed, zlib.crc32(name.encode()))))
