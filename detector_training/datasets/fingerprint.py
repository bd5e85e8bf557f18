"""Which pictures are the same, byte for byte or to the eye."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Look: TypeAlias = NDArray[np.uint64]  # (4,)
"""256 bits: where a picture of 17 x 16 pixels gets lighter from left to right."""

LOOK_BITS = 256
SAME_BITS = 12
"""Looks that differ by so few bits are one picture, encoded or lit a little differently."""
_FLAT_LEVELS = 2.0
"""A picture without contrast has no look: its bits would be noise."""
_MAX_CELLS = 1 << 20
"""Pairs that are compared at once: bounds the memory, 32 bytes each."""


def digest(data: bytes) -> str:
    """SHA-256 of a file, in hex."""
    return hashlib.sha256(data).hexdigest()


def look_of(rgb: NDArray[np.uint8]) -> Look | None:
    """The look of a picture (H, W, 3) or (H, W); None where it is all of one shade."""
    small = cv2.resize(rgb, (17, 16), interpolation=cv2.INTER_AREA).astype(np.float32)
    gray = small if small.ndim == 2 else small.mean(-1)
    if float(gray.std()) < _FLAT_LEVELS:
        return None
    look: Look = np.packbits(gray[:, 1:] > gray[:, :-1]).view(np.uint64)
    return look


def difference(a: Look, b: Look) -> int:
    """Number of bits in which two looks differ, 0 to ``LOOK_BITS``."""
    return int(np.bitwise_count(a ^ b).sum())


def nearest_alike(
    first: Sequence[Look | None], second: Sequence[Look | None], most_bits: int = SAME_BITS
) -> list[int | None]:
    """For each look the index of the nearest one in ``second``, where that is near enough."""
    nearest: list[int | None] = [None] * len(first)
    rows, a = _known(first)
    columns, b = _known(second)
    if columns:
        for start, bits in _differences(a, b):
            best = bits.argmin(1)
            for k in np.flatnonzero(bits[np.arange(len(bits)), best] <= most_bits):
                nearest[rows[start + k]] = columns[best[k]]
    return nearest


def link_alike(looks: Sequence[Look | None], most_bits: int = SAME_BITS) -> Iterator[list[int]]:
    """Sets of two indices or more whose looks are linked by steps of at most ``most_bits``."""
    known, a = _known(looks)
    label = np.arange(len(known))
    for _, bits in _differences(a, a):
        for near in bits <= most_bits:
            mine = label[near]
            if mine.min() != mine.max():
                label[np.isin(label, mine)] = mine.min()
    order = np.argsort(label, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
        if len(members) > 1:
            yield [known[m] for m in members]


def _known(looks: Sequence[Look | None]) -> tuple[list[int], NDArray[np.uint64]]:
    """Indices of the looks that there are, and these (N, 4)."""
    found = [(i, look) for i, look in enumerate(looks) if look is not None]
    stacked = np.array([look for _, look in found], np.uint64).reshape(-1, LOOK_BITS // 64)
    return [i for i, _ in found], stacked


def _differences(
    a: NDArray[np.uint64], b: NDArray[np.uint64]
) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Bits between rows of ``a`` from an index on and all of ``b``, some rows at a time."""
    step = max(_MAX_CELLS // max(len(b), 1), 1)
    for start in range(0, len(a), step):
        yield start, np.bitwise_count(a[start : start + step, None] ^ b[None]).sum(-1, np.int64)
