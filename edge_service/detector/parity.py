"""Does an exported graph say what the net says? Compared cell by cell, before any suppression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge_service.detector.layouts import Outputs
from edge_service.errors import WeightsError

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
    """Logits (B, N, C) and distances (B, N, C, 4) of the same pictures, by two engines.

    Raises:
        WeightsError: their shapes differ.
    """
    box_px = score = 0.0
    for ours, theirs in zip(want, got, strict=True):
        shapes = [[o.shape for o in outputs] for outputs in (ours, theirs)]
        if shapes[0] != shapes[1]:
            raise WeightsError(f"the export answers in shapes {shapes[1]}, the net in {shapes[0]}")
        a, b = (1 / (1 + np.exp(-o[0].astype(np.float64))) for o in (ours, theirs))
        counts = np.maximum(a, b) >= COUNTS_FROM
        score = float(np.maximum(score, np.max(np.abs(a - b), initial=0.0)))
        far = np.abs(ours[1] - theirs[1])[counts]
        box_px = float(np.maximum(box_px, np.max(far, initial=0.0)))
    return Parity(sum(len(outputs[0]) for outputs in want), box_px, score)


def require_parity(parity: Parity, what: str) -> None:
    """Refuse an export that says something else than its net.

    Raises:
        WeightsError: by how much.
    """
    if not parity.holds:
        raise WeightsError(
            f"{what}: the export is {parity.box_px:.2g} px and {parity.score:.2g} of score off the "
            f"net on {parity.pictures} pictures; at most {MAX_BOX_PX:g} px and {MAX_SCORE:g} pass. "
            "Nothing was written"
        )
