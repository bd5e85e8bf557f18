"""Does an exported graph say what the net says? Compared cell by cell, before any suppression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from detector_training.errors import ExportError
from edge_service.detector.layouts import Outputs

MAX_BOX_PX = 1.0
MAX_SCORE = 1e-3
COUNTS_FROM = 0.05
"""Boxes of cells with a lower score are never told, wherever they lie."""


@dataclass(frozen=True, slots=True)
class Parity:
    """The largest differences over all pictures and cells."""

    pictures: int
    box_px: float
    score: float

    @property
    def holds(self) -> bool:
        """Both are small enough."""
        return self.box_px <= MAX_BOX_PX and self.score <= MAX_SCORE  # not so for a NaN


def compare(want: Sequence[Outputs], got: Sequence[Outputs]) -> Parity:
    """Logits (1, N, C) and distances (1, N, C, 4) of the same pictures, by two engines.

    Raises:
        ExportError: their shapes differ.
    """
    box_px = score = 0.0
    for ours, theirs in zip(want, got, strict=True):
        shapes = [[o.shape for o in outputs] for outputs in (ours, theirs)]
        if shapes[0] != shapes[1]:
            raise ExportError(f"the export answers in shapes {shapes[1]}, the net in {shapes[0]}")
        a, b = (1 / (1 + np.exp(-o[0].astype(np.float64))) for o in (ours, theirs))
        counts = np.maximum(a, b) >= COUNTS_FROM
        score = float(np.maximum(score, np.max(np.abs(a - b), initial=0.0)))
        far = np.abs(ours[1] - theirs[1])[counts]
        box_px = float(np.maximum(box_px, np.max(far, initial=0.0)))
    return Parity(len(want), box_px, score)
