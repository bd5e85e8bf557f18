"""The guard around the detector: many may ask, one is inside."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

from edge_service.guarded import GuardedDetector
from tests.unit.edge_service.edge_fakes import COLOR, KnownDetector


class JealousDetector(KnownDetector):
    """Notices a second caller while the first one is inside."""

    def __init__(self, callers):
        super().__init__()
        self.overlaps = 0
        self._alone = threading.Lock()
        self._all_here = threading.Barrier(callers)

    def meet(self):
        self._all_here.wait(timeout=20)

    def detect(self, color_rgb):
        if not self._alone.acquire(blocking=False):
            self.overlaps += 1
            return super().detect(color_rgb)
        for _ in range(2000):  # long enough for others to come
            color_rgb.sum()
        self._alone.release()
        return super().detect(color_rgb)


def test_one_inference_at_a_time():
    """Threads that ask at once are let in one after the other, and each gets its answer."""
    detector = JealousDetector(callers=3)
    guarded = GuardedDetector(detector)

    def ask(_):
        detector.meet()
        return guarded.detect(COLOR[:8, :8])

    with ThreadPoolExecutor(3) as pool:
        answers = list(pool.map(ask, range(3)))
    assert answers == [detector.detections] * 3
    assert detector.overlaps == 0
    assert guarded.detect_batch([COLOR, COLOR]) == [detector.detections] * 2
    assert guarded.model_hash == detector.model_hash
    assert guarded.describe() == detector.describe()
