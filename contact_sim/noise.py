"""Random numbers one at a time, as cheap as a list: what draws 250 times a second needs that."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, repeat

import numpy as np

BLOCK = 4096


def normals(rng: np.random.Generator) -> Iterator[float]:
    """Standard normal numbers without end, drawn from the generator in blocks."""
    blocks = (rng.standard_normal(BLOCK).tolist() for _ in repeat(None))
    return chain.from_iterable(blocks)
