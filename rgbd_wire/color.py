"""Colour on the wire: JPEG, decoded only into a picture of the size that the header announced."""

from __future__ import annotations

import struct

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.errors import DecodeError, Reject

DEFAULT_JPEG_QUALITY = 80


def encode_color(color_rgb: NDArray[np.uint8], quality: int = DEFAULT_JPEG_QUALITY) -> bytes:
    """JPEG 4:2:0 of a colour picture (H, W, 3); ``quality`` in [1, 100]."""
    return bytes(
        imagecodecs.jpeg8_encode(np.ascontiguousarray(color_rgb), level=quality, subsampling="420")
    )


def decode_color(data: bytes | memoryview, width: int, height: int) -> NDArray[np.uint8]:
    """Picture (H, W, 3) of a baseline JPEG.

    The JPEG's own header is compared with that size before the codec sees it, so a small file that
    claims a huge picture allocates nothing. The codec would compare it as well, but when that fails
    it never gives back what it has allocated.

    Raises:
        DecodeError: BAD_COLOR, not a whole baseline colour JPEG of that size.
    """
    _check_frame(data, width, height)
    color_rgb = np.empty((height, width, 3), np.uint8)
    try:
        imagecodecs.jpeg8_decode(bytes(data), out=color_rgb)
    except (imagecodecs.Jpeg8Error, ValueError) as error:
        raise DecodeError(Reject.BAD_COLOR, f"JPEG of {width}x{height}: {error}") from None
    return color_rgb


_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
_BASELINE_FRAME, _SCAN = 0xC0, 0xDA
_TABLES = frozenset({0xC4, 0xDB, 0xDD, 0xFE, *range(0xE0, 0xF0)})
_MAX_SEGMENTS = 64
_FRAME = struct.Struct(">BHHB")
"""Bits a value, height, width, colours."""


def _check_frame(data: bytes | memoryview, width: int, height: int) -> None:
    """Refuse a JPEG of another size, cut off, progressive, or of several scans.

    Each scan costs the decoder a pass over the whole picture and the sender ten bytes, so 250 kB
    of empty scans can hold a worker for a quarter of a minute.
    """
    view = memoryview(data)
    if view[:2] != _SOI or view[-2:] != _EOI:
        raise DecodeError(Reject.BAD_COLOR, "not a whole JPEG: its first or last marker is missing")
    at, baseline = 2, False
    for _ in range(_MAX_SEGMENTS):
        head = bytes(view[at : at + 5])  # 0xFF, marker, length, first byte of the content
        if len(head) < 5 or head[0] != 0xFF:
            break
        marker, length, first = head[1], int.from_bytes(head[2:4], "big"), head[4]
        if marker == _SCAN and baseline and first == 3:
            return
        if marker != _BASELINE_FRAME and marker not in _TABLES:
            break
        if marker == _BASELINE_FRAME:
            baseline = True
            claim = bytes(view[at + 4 : at + 10])
            if claim != _FRAME.pack(8, height, width, 3):
                raise DecodeError(Reject.BAD_COLOR, _mismatch(claim, width, height))
        at += 2 + length
    raise DecodeError(
        Reject.BAD_COLOR, f"byte {at}: not a baseline JPEG with one scan of 3 colours"
    )


def _mismatch(claim: bytes, width: int, height: int) -> str:
    if len(claim) < _FRAME.size:
        return "a JPEG's frame header that is cut off"
    bits, has_height, has_width, colors = _FRAME.unpack(claim)
    what = f"a JPEG of {has_width}x{has_height}, {colors} colours of {bits} bits"
    return f"{what}, not {width}x{height}, 3 of 8"
