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
_BLOCK = 512


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


def alike(
    first: Sequence[Look | None], second: Sequence[Look | None], most_bits: int = SAME_BITS
) -> Iterator[tuple[int, int]]:
    """Indices (i, j) of all pairs of looks that differ by at most ``most_bits``."""
    rows = [i for i, look in enumerate(first) if look is not None]
    columns = [j for j, look in enumerate(second) if look is not None]
    if not (rows and columns):
        return
    a = np.stack([look for look in first if look is not None])
    b = np.stack([look for look in second if look is not None])
    for start in range(0, len(a), _BLOCK):
        bits = np.bitwise_count(a[start : start + _BLOCK, None] ^ b[None]).sum(-1, dtype=np.int64)
        for i, j in np.argwhere(bits <= most_bits):
            yield rows[start + i], columns[j]
