"""The net's cells: where they lie in an input, in numpy alone.

Pixel (0, 0) is the centre of the first pixel. An engine without torch decodes with this.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

STRIDES = (8, 16, 32)
"""Pixels per cell of the three output grids; ``net.STRIDES`` are the same (tested)."""

SIZE_MULTIPLE_PX = STRIDES[-1]
"""Both sides of an input are multiples of this."""


def padded_side(side_px: int, multiple_px: int = SIZE_MULTIPLE_PX) -> int:
    """The next multiple of ``multiple_px`` that holds ``side_px`` pixels."""
    return -(-side_px // multiple_px) * multiple_px


@lru_cache(maxsize=16)  # a stream has one size; strangers shall not fill memory
def cell_centers(height: int, width: int) -> NDArray[np.float32]:
    """Centres (N, 2) as (u, v) [px] of all cells of an input, in the net's order; read-only.

    A cell of stride s covers s pixels, 0 to s - 1 the first, so its centre is at (s - 1) / 2.
    """
    centers = []
    for stride in STRIDES:
        v, u = np.mgrid[: height // stride, : width // stride].astype(np.float32)
        centers.append(np.stack((u, v), -1).reshape(-1, 2) * stride + (stride - 1) / 2)
    whole = np.concatenate(centers).astype(np.float32)
    whole.setflags(write=False)
    return whole
