"""Depth on the wire: the rank of each value on the sensor's lattice, then lossless JPEG XL.

Raw stereo depth can only take the values ``round(A / n / scale)`` for integer disparities ``n``
(in 1/32 px), with ``A = fx * baseline * 32``. The rank of a value among those is a code of 11 to
12 bits instead of 16, with smaller steps between neighbours: half the bytes of PNG. Rank 0 stands
for "no depth". Values off the lattice (another sensor, aligned depth) make the whole picture go
out under the identity table, with the same codec and just as lossless.
"""

from __future__ import annotations

from enum import StrEnum
from functools import lru_cache

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.errors import DecodeError, Reject
from rgbd_wire.jxl_header import check_plain_picture

MAX_DEPTH_UNITS = 65535


class DepthTable(StrEnum):
    """How the numbers in the coded picture map to depth units."""

    IDENTITY = "identity"
    LATTICE = "lattice"


@lru_cache(maxsize=8)
def lattice_values(lattice_m: float, depth_scale_m: float) -> NDArray[np.uint16]:
    """All depths [units] a stereo sensor can give, ascending, with 0 ("none") first: (K,).

    Disparity runs over the positive integers; values past 16 bits are left out.
    """
    a_units = lattice_m / depth_scale_m
    # From the disparity whose depth is the largest that fits, to the one whose depth rounds to 0.
    first = max(1, int(np.ceil(a_units / (MAX_DEPTH_UNITS + 0.5))))
    last = min(int(2 * a_units) + 1, first + 4 * MAX_DEPTH_UNITS)
    depths = np.rint(a_units / np.arange(first, last + 1, dtype=np.float64))
    values = np.unique(depths[(depths >= 1) & (depths <= MAX_DEPTH_UNITS)]).astype(np.uint16)
    values = np.concatenate([np.zeros(1, np.uint16), values])
    values.flags.writeable = False
    return values


@lru_cache(maxsize=8)
def _rank_of_units(lattice_m: float, depth_scale_m: float) -> NDArray[np.uint16]:
    """Rank (65536,) of each depth; a depth off the lattice has the rank of its lower neighbour."""
    values = lattice_values(lattice_m, depth_scale_m)
    ranks = np.searchsorted(values, np.arange(MAX_DEPTH_UNITS + 1), side="right") - 1
    return ranks.astype(np.uint16)


def encode_depth(
    depth_units: NDArray[np.uint16], lattice_m: float, depth_scale_m: float
) -> tuple[DepthTable, bytes]:
    """Code a depth picture (h, w), lossless; ``lattice_m`` 0 means that the lattice is unknown."""
    table, codes = DepthTable.IDENTITY, np.ascontiguousarray(depth_units)
    if lattice_m > 0:
        ranks = _rank_of_units(lattice_m, depth_scale_m)[depth_units]
        if np.array_equal(lattice_values(lattice_m, depth_scale_m)[ranks], depth_units):
            table, codes = DepthTable.LATTICE, ranks
    data = imagecodecs.jpegxl_encode(codes, lossless=True, effort=1, numthreads=1)
    return table, bytes(data)


def decode_depth(
    data: bytes | memoryview,
    table: DepthTable,
    width: int,
    height: int,
    lattice_m: float,
    depth_scale_m: float,
) -> NDArray[np.uint16]:
    """Depth picture (h, w) [units] of its code.

    The codec compares the file's own header with the picture that it is given before it decodes.

    Raises:
        DecodeError: BAD_DEPTH, not a 16-bit picture of that size, or a rank that does not exist.
    """
    check_plain_picture(data)
    codes = np.empty((height, width), np.uint16)
    try:
        imagecodecs.jpegxl_decode(bytes(data), out=codes, numthreads=1)
    except (RuntimeError, ValueError) as error:  # the codec raises bare RuntimeErrors too
        raise DecodeError(Reject.BAD_DEPTH, f"JPEG XL of {width}x{height}: {error}") from None
    if table is DepthTable.IDENTITY:
        return codes
    if lattice_m <= 0:
        raise DecodeError(Reject.BAD_DEPTH, "rank codes without a lattice")
    values = lattice_values(lattice_m, depth_scale_m)
    if int(codes.max()) >= values.size:
        raise DecodeError(Reject.BAD_DEPTH, f"rank {int(codes.max())} of {values.size} values")
    return np.asarray(values[codes])
