"""Depth on the wire: the rank of each value on the sensor's lattice, then lossless JPEG XL.

Raw stereo depth can only take the values ``round(A / n / scale)`` for integer disparities ``n``
(in 1/32 px), with ``A = fx * baseline * 32``. The rank of a value among those is a code of 11 to
12 bits instead of 16, with smaller steps between neighbours: half the bytes of PNG. Rank 0 stands
for "no depth". Values off the lattice (another sensor, aligned depth) make the whole picture go
out under the identity table, with the same codec and just as lossless.

On a slow link a ``DepthPlan`` leaves pixels out: full resolution in a region, every second or
fourth row and column elsewhere, nothing past a range. What is sent stays lossless, since a rounded
depth is a bias on a flat target; what is not arrives as "no depth", and nothing is made up.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Literal, TypeAlias

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
    """Rank (65536,) of each depth; a depth off the lattice has 65535, which is then no rank."""
    values = lattice_values(lattice_m, depth_scale_m)
    ranks = np.full(MAX_DEPTH_UNITS + 1, MAX_DEPTH_UNITS, np.uint16)
    ranks[values] = np.arange(values.size)
    ranks.flags.writeable = False
    return ranks


Region: TypeAlias = tuple[int, int, int, int]
"""x0, y0, x1, y1 in pixels of a picture; x1 and y1 lie behind the last column and row."""
Step: TypeAlias = Literal[1, 2, 4]
STEPS: tuple[Step, ...] = (1, 2, 4)


@dataclass(frozen=True, slots=True)
class DepthPlan:
    """Which pixels of a depth picture are sent; the rest arrives as "no depth".

    Raises:
        ValueError: a step that is none of ``STEPS``, or a range that is not positive.
    """

    step: Step = 1
    """Every so-manieth row and column, outside the region; 1: all."""
    region: Region | None = None
    """Sent at full resolution; it is cut to the picture."""
    range_max_m: float | None = None
    """What is farther away is not sent; None: all is."""

    def __post_init__(self) -> None:
        if self.step not in STEPS:
            raise ValueError(f"a step is one of {STEPS}, not {self.step}")
        if self.range_max_m is not None and not self.range_max_m > 0:
            raise ValueError(f"a range is positive, not {self.range_max_m} m")


ALL_OF_IT = DepthPlan()


@dataclass(frozen=True, slots=True)
class CodedDepth:
    """A depth picture on the wire."""

    table: DepthTable
    step: Step
    coarse: bytes | memoryview
    """Every ``step``-th row and column, the region's blank."""
    region: Region | None
    """None: there is no picture of its own."""
    fine: bytes | memoryview
    """The region at full resolution; empty where there is none."""

    @property
    def size_bytes(self) -> int:
        """Of both pictures."""
        return len(self.coarse) + len(self.fine)


NO_DEPTH = CodedDepth(DepthTable.IDENTITY, 1, b"", None, b"")
"""A frame without a depth picture."""


def encode_depth(
    depth_units: NDArray[np.uint16],
    lattice_m: float,
    depth_scale_m: float,
    plan: DepthPlan = ALL_OF_IT,
) -> CodedDepth:
    """Code what the plan says of a depth picture (h, w), and that without loss.

    Args:
        depth_units: the picture.
        lattice_m: A of the sensor's lattice; 0: unknown.
        depth_scale_m: metres of a unit.
        plan: which pixels.
    """
    h, w = depth_units.shape
    s = plan.step
    region = None if plan.region is None or s == 1 else _cut(plan.region, (h, w))
    if region == (0, 0, w, h):
        s, region = 1, None  # all of it, as one picture
    # What is left out first, since every look at a pixel costs the drone
    parts = [_near(depth_units[::s, ::s], plan.range_max_m, depth_scale_m)]
    if region is not None:
        x0, y0, x1, y1 = region
        parts.append(_near(depth_units[y0:y1, x0:x1], plan.range_max_m, depth_scale_m))
        parts[0] = parts[0].copy()
        # These samples are in the other part
        parts[0][-(-y0 // s) : -(-y1 // s), -(-x0 // s) : -(-x1 // s)] = 0
    table = DepthTable.IDENTITY
    if lattice_m > 0:
        ranks_of_units = _rank_of_units(lattice_m, depth_scale_m)
        count = lattice_values(lattice_m, depth_scale_m).size
        ranks = [ranks_of_units[part] for part in parts]
        if all(int(part.max()) < count for part in ranks):
            table, parts = DepthTable.LATTICE, ranks
    coarse, *fine = map(_jxl, parts)
    return CodedDepth(table, s, coarse, region, fine[0] if fine else b"")


def _near(
    units: NDArray[np.uint16], range_max_m: float | None, depth_scale_m: float
) -> NDArray[np.uint16]:
    """The same without what is too far away."""
    if range_max_m is None:
        return units
    far_units = min(range_max_m / depth_scale_m, float(MAX_DEPTH_UNITS))
    return np.where(units > np.uint16(far_units), np.uint16(0), units)


def _cut(region: Region, shape: tuple[int, ...]) -> Region | None:
    x0, y0, x1, y1 = region
    x0, y0, x1, y1 = max(0, x0), max(0, y0), min(shape[1], x1), min(shape[0], y1)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def _jxl(codes: NDArray[np.uint16]) -> bytes:
    return bytes(
        imagecodecs.jpegxl_encode(
            np.ascontiguousarray(codes), lossless=True, effort=1, numthreads=1
        )
    )


def coarse_size(width: int, height: int, step: int) -> tuple[int, int]:
    """Width and height of every ``step``-th column and row."""
    return -(-width // step), -(-height // step)


def decode_depth(
    coded: CodedDepth,
    width: int,
    height: int,
    lattice_m: float,
    depth_scale_m: float,
) -> NDArray[np.uint16]:
    """Depth picture (h, w) [units] of its code; a pixel that was not sent is 0, "no depth".

    Raises:
        DecodeError: BAD_DEPTH, a part is no 16-bit picture of its size, the region is no part of
            the picture, or a rank does not exist.
    """
    step, region = coded.step, coded.region
    if (region is not None and step == 1) or (region is None) != (len(coded.fine) == 0):
        raise DecodeError(
            Reject.BAD_DEPTH, f"step {step}, region {region}, {len(coded.fine)} bytes"
        )
    if region is not None and _cut(region, (height, width)) != region:
        raise DecodeError(Reject.BAD_DEPTH, f"region {region} of a picture of {width}x{height}")
    coarse = _picture(coded.coarse, *coarse_size(width, height, step))
    if step == 1:
        return _units(coarse, coded.table, lattice_m, depth_scale_m)
    codes = np.zeros((height, width), np.uint16)
    codes[::step, ::step] = coarse
    if region is not None:
        x0, y0, x1, y1 = region
        codes[y0:y1, x0:x1] = _picture(coded.fine, x1 - x0, y1 - y0)
    return _units(codes, coded.table, lattice_m, depth_scale_m)


def _picture(data: bytes | memoryview, width: int, height: int) -> NDArray[np.uint16]:
    """The codec compares the file's own header with the picture that it is given first."""
    check_plain_picture(data)
    codes = np.empty((height, width), np.uint16)
    try:
        imagecodecs.jpegxl_decode(bytes(data), out=codes, numthreads=1)
    except (RuntimeError, ValueError) as error:  # the codec raises bare RuntimeErrors too
        raise DecodeError(Reject.BAD_DEPTH, f"JPEG XL of {width}x{height}: {error}") from None
    return codes


def _units(
    codes: NDArray[np.uint16], table: DepthTable, lattice_m: float, depth_scale_m: float
) -> NDArray[np.uint16]:
    if table is DepthTable.IDENTITY:
        return codes
    if lattice_m <= 0:
        raise DecodeError(Reject.BAD_DEPTH, "rank codes without a lattice")
    values = lattice_values(lattice_m, depth_scale_m)
    if int(codes.max()) >= values.size:
        raise DecodeError(Reject.BAD_DEPTH, f"rank {int(codes.max())} of {values.size} values")
    return np.asarray(values[codes])
