"""Which pictures are scored together: by condition, by recipe, by distance, by apparent size."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from itertools import pairwise

from detector_training.datasets.sample import Sample
from detector_training.evaluation.matching import board_px

ALL = "all"
NEGATIVE = "negative"
DISTANCES_M = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0)
"""Ends of the bins; what is further is one more."""
SIZES_PX = (0.0, 10.0, 14.0, 20.0, 28.0, 40.0, 80.0, 160.0, 320.0)
"""Likewise of the board's width."""


class By(StrEnum):
    """What pictures are grouped by."""

    CONDITION = "condition"
    RECIPE = "recipe"
    DISTANCE = "distance_m"
    SIZE = "board_px"


def groups(samples: Sequence[Sample]) -> dict[By, dict[str, list[int]]]:
    """Indices of the pictures of each group, in the order of a report.

    Pictures without a target are in no bin of distance or size.
    """
    found: dict[By, dict[str, list[int]]] = {by: {} for by in By}
    for k, sample in enumerate(samples):
        names = [ALL, *sample.conditions]
        if sample.kind == NEGATIVE:
            names.append(NEGATIVE)
        for name in dict.fromkeys(names):
            found[By.CONDITION].setdefault(name, []).append(k)
        if sample.recipe is not None:
            found[By.RECIPE].setdefault(sample.recipe, []).append(k)
        if (width := board_px(sample)) is not None:
            found[By.SIZE].setdefault(bin_name(width, SIZES_PX), []).append(k)
            if sample.distance_m is not None:
                name = bin_name(sample.distance_m, DISTANCES_M)
                found[By.DISTANCE].setdefault(name, []).append(k)
    ordered = {
        By.CONDITION: sorted(found[By.CONDITION], key=lambda c: (c != ALL, c)),
        By.RECIPE: sorted(found[By.RECIPE]),
        By.DISTANCE: [n for n in bin_names(DISTANCES_M) if n in found[By.DISTANCE]],
        By.SIZE: [n for n in bin_names(SIZES_PX) if n in found[By.SIZE]],
    }
    return {by: {name: found[by][name] for name in names} for by, names in ordered.items()}


def bin_names(ends: Sequence[float]) -> list[str]:
    """The names of all bins, in order."""
    return [f"{a:g}-{b:g}" for a, b in pairwise(ends)] + [f">{ends[-1]:g}"]


def bin_name(value: float, ends: Sequence[float]) -> str:
    """The bin of a value; a bin holds its lower end."""
    inside = sum(value >= end for end in ends[1:])
    return bin_names(ends)[inside]
