"""Pictures as runtimes of ONNX take them: planes of numbers in [0, 1]."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


class FloatPlanes:
    """Turns bytes into planes, in memory that stays from one call to the next."""

    def __init__(self) -> None:
        self._planes = np.empty((0, 3, 0, 0), np.float32)

    def of(self, pictures: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Pictures (B, H, W, 3) as (B, 3, H, W) in [0, 1]; valid until the next call."""
        batch, height, width, _ = pictures.shape
        if self._planes.shape != (batch, 3, height, width):
            self._planes = np.empty((batch, 3, height, width), np.float32)
        for picture, planes in zip(pictures, self._planes, strict=True):
            # split first: a stride of 3 bytes makes the multiplication twice as slow
            for channel, plane in zip(cv2.split(picture), planes, strict=True):
                np.multiply(channel, np.float32(1 / 255), out=plane)
        return self._planes
