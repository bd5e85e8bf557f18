"""Training and validation pictures told apart, so that no picture has its twin on the other side.

Frames of one recording are near copies of each other: trained on one and measured on the next, any
net looks good. Pictures go together when they look alike, when they follow each other in one folder
and have much in common, and on demand when they lie in one folder at all.
"""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from detector_training.datasets.fingerprint import Look, difference, link_alike, look_of
from detector_training.datasets.inspection import MAX_COMPARED
from detector_training.datasets.sample import Sample, decode_image, read_bytes
from detector_training.errors import DatasetError

NEXT_BITS = 58
"""Frames that follow each other and differ by so few of 256 bits are of one recording. Those of the
real recording of a flight differ by 19 to 52, pictures of other places by 100 and more; of 1770
pairs of rendered scenes one in a thousand by less than 63."""


@dataclass(frozen=True, slots=True)
class Split:
    """Both sides, each in the order of the data set."""

    train: tuple[Sample, ...]
    val: tuple[Sample, ...]
    groups: int
    """Number of groups that were to be kept together."""
    cut: bool
    """Whether one recording had to be cut in two, because there is no other."""


def looks_of(
    samples: Sequence[Sample], on_progress: Callable[[int], None] = lambda done: None
) -> list[Look | None]:
    """The look of every picture.

    Raises:
        DatasetError: a picture cannot be read.
    """
    looks = []
    for done, sample in enumerate(samples, 1):
        looks.append(look_of(decode_image(sample, read_bytes(sample.image))))
        on_progress(done)
    return looks


def group_alike(
    samples: Sequence[Sample], looks: Sequence[Look | None], by_folder: bool = False
) -> list[list[int]]:
    """Indices of the pictures that belong together, each once.

    Args:
        samples: The pictures.
        looks: Of each.
        by_folder: Keep whole folders together.
    """
    together = _Groups(len(samples))
    folders: defaultdict[str, list[int]] = defaultdict(list)
    for i, sample in enumerate(samples):
        folders[os.path.abspath(sample.image.parent)].append(i)
    for members in folders.values():
        members.sort(key=lambda i: _natural(samples[i].image.name))
        for i, j in pairwise(members):
            if by_folder or _follows(looks[i], looks[j]):
                together.join(i, j)
    if len(samples) <= MAX_COMPARED:
        for members in link_alike(looks):
            for i, j in pairwise(members):
                together.join(i, j)
    return together.members()


def split_groups(
    samples: Sequence[Sample], groups: Sequence[Sequence[int]], val: float, seed: int
) -> Split:
    """Draw groups by chance until a share of the pictures is held out.

    Where the groups are too coarse for that, the largest is cut in two in its order: its last
    pictures are held out.

    Args:
        samples: The pictures.
        groups: Indices of those that belong together.
        val: Share to hold out, in (0, 1).
        seed: The same seed draws the same pictures.

    Raises:
        DatasetError: the share is impossible, or there are too few pictures.
    """
    if not 0 < val < 1:
        raise DatasetError(f"--val {val}: give the share to hold out, between 0 and 1")
    if seed < 0:
        raise DatasetError(f"--seed {seed}: give a whole number from 0 on")
    if len(samples) < 2:
        raise DatasetError("there must be two pictures at least to split")
    wanted = min(max(round(val * len(samples)), 1), len(samples) - 1)
    held: set[int] = set()
    for g in np.random.default_rng(seed).permutation(len(groups)):
        # half a group too many is as near as half a group too few
        if len(held) + len(groups[g]) / 2 <= wanted and len(held) + len(groups[g]) < len(samples):
            held.update(groups[g])
    cut = not held
    if cut:
        largest = max(groups, key=len)
        held.update(largest[-min(wanted, len(largest) - 1) :])
    sides = [
        tuple(replace(s, split=name) for i, s in enumerate(samples) if (i in held) is inside)
        for name, inside in (("train", False), ("val", True))
    ]
    return Split(sides[0], sides[1], len(groups), cut)


class _Groups:
    """Disjoint sets of 0 to ``count`` - 1, each named by its least member."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))

    def join(self, i: int, j: int) -> None:
        """Put the sets of two members together."""
        i, j = self._root(i), self._root(j)
        self._parent[max(i, j)] = min(i, j)

    def members(self) -> list[list[int]]:
        """The sets, each in rising order."""
        groups: defaultdict[int, list[int]] = defaultdict(list)
        for i in range(len(self._parent)):
            groups[self._root(i)].append(i)
        return list(groups.values())

    def _root(self, i: int) -> int:
        while self._parent[i] != i:
            self._parent[i] = self._parent[self._parent[i]]
            i = self._parent[i]
        return i


def _follows(a: Look | None, b: Look | None) -> bool:
    if a is None or b is None:  # dark frames of one recording tell nothing apart
        return a is b
    return difference(a, b) <= NEXT_BITS


def _natural(name: str) -> list[tuple[int, str]]:
    """Sorts frame9 before frame10."""
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"([0-9]{1,18})", name)]
