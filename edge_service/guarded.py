"""A detector that several threads may ask: one inference at a time."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_service.pipeline import Detector
from target_pose.candidate import Detections


class GuardedDetector:
    """Lets one thread at a time into a detector that is not made for more.

    Args:
        detector: does the work.
        told: what is known of it beside what it says of itself.
    """

    def __init__(self, detector: Detector, told: Mapping[str, Any] | None = None) -> None:
        self._detector = detector
        self._told = dict(told or {})
        self._lock = threading.Lock()

    @property
    def model_hash(self) -> str:
        """SHA-256 of the weights."""
        return self._detector.model_hash

    def detect(self, color_rgb: NDArray[np.uint8]) -> Detections:
        """All boxes of a picture (H, W, 3), once it is this thread's turn."""
        with self._lock:
            return self._detector.detect(color_rgb)

    def detect_batch(self, colors_rgb: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        """All boxes of several pictures, once it is this thread's turn."""
        with self._lock:
            return self._detector.detect_batch(colors_rgb)

    def describe(self) -> dict[str, Any]:
        """What it is and how it runs."""
        return {**self._detector.describe(), **self._told}
