"""A camera that hangs and gives the same picture again and again, with new stamps.

Nothing downstream could tell: every answer would be fresh, and say that the target moves along with
the drone. But no two exposures of a real sensor are alike to the last bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class FrozenWatch:
    """Holds each picture against the one before it. Not thread-safe."""

    def __init__(self) -> None:
        self.frozen = 0
        """Pictures that were the same as the one before."""
        self._last: NDArray[np.uint8] | None = None

    def see(self, color_rgb: NDArray[np.uint8]) -> bool:
        """Whether a picture (H, W, 3) is the last one again, which must not be sent."""
        last, self._last = self._last, color_rgb
        if last is None or not (last is color_rgb or np.array_equal(last, color_rgb)):
            return False
        self.frozen += 1
        return True
