"""Where something has been, as a line of bounded length."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

MAX_POINTS: Final = 2000
STEP_M: Final = 0.01
"""A point nearer to the last one is none of its own."""


class Way:
    """Keeps the shape of a whole flight: when it is full, every other point goes."""

    def __init__(self, max_points: int = MAX_POINTS, step_m: float = STEP_M) -> None:
        self._max_points = max_points
        self._step_m = step_m
        self._points: list[NDArray[np.float64]] = []

    def add(self, point: NDArray[np.float64]) -> None:
        """Go on to a point (3,) [m]."""
        if self._points and np.linalg.norm(point - self._points[-1]) < self._step_m:
            return
        if len(self._points) >= self._max_points:
            del self._points[1::2]
            self._step_m *= 2.0
        self._points.append(np.array(point, dtype=np.float64))

    def points(self) -> NDArray[np.float64]:
        """All of it, (n, 3)."""
        return np.array(self._points, dtype=np.float64).reshape(-1, 3)
