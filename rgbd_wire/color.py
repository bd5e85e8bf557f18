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
    """Picture (H, W, 3) of a JPEG.

    The codec compares the JPEG's own header with the picture that it is given before it decodes,
    so a small file that claims a huge picture allocates nothing.

    Raises:
        DecodeError: BAD_COLOR, not a whole RGB JPEG of that size.
    """
    color_rgb = np.empty((height, width, 3), np.uint8)
    try:
        imagecodecs.jpeg8_decode(bytes(data), out=color_rgb)
    except (imagecodecs.Jpeg8Error, ValueError) as error:
        raise DecodeError(Reject.BAD_COLOR, f"JPEG of {width}x{height}: {error}") from None
    return color_rgb
