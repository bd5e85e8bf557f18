"""Colour on the wire: JPEG, decoded only into a picture of the size that the header announced."""

from __future__ import annotations

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

    The codec compares the JPEG's own header with the picture that it is given before it decodes,
    so a small file that claims a huge picture allocates nothing.

    Raises:
        DecodeError: BAD_COLOR, not a whole baseline colour JPEG of that size.
    """
    _check_single_scan(data)
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


def _check_single_scan(data: bytes | memoryview) -> None:
    """Refuse a JPEG that is cut off, progressive, or brings its components in several scans.

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
        baseline |= marker == _BASELINE_FRAME
        at += 2 + length
    raise DecodeError(
        Reject.BAD_COLOR, f"byte {at}: not a baseline JPEG with one scan of 3 colours"
    )
