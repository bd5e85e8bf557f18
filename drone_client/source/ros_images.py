"""Pictures in ROS messages, raw and compressed, as ours; a reason where they are not.

Depth is sent as 16-bit millimetres (``16UC1``) or as metres in floats (``32FC1``), and compressed
by compressed_depth_image_transport: a head of 12 bytes (format and two floats A, B), then a PNG of
the millimetres, or for floats of the inverse depth, ``depth = A / (value - B)``.
"""

from __future__ import annotations

import struct
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import MAX_PIXELS, MAX_SIDE_PX

DEPTH_HEAD_BYTES: Final = 12
MILLIMETRE_M: Final = 0.001
FLOAT_DEPTH_SCALE_M: Final = 0.0005
"""Unit to which metres in floats are rounded: half a millimetre, up to 32 m."""
_CHANNELS: Final = {
    "rgb8": 3,
    "bgr8": 3,
    "8uc3": 3,
    "rgba8": 4,
    "bgra8": 4,
    "mono8": 1,
    "8uc1": 1,
}
_TO_RGB: Final = {
    "bgr8": cv2.COLOR_BGR2RGB,
    "8uc3": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "mono8": cv2.COLOR_GRAY2RGB,
    "8uc1": cv2.COLOR_GRAY2RGB,
}
_MILLIMETRES: Final = ("16uc1", "mono16")
_METRES: Final = ("32fc1",)


class PictureError(Exception):
    """A message holds no picture that we can read; says why."""


def color_rgb(message: Any) -> NDArray[np.uint8]:
    """The picture (H, W, 3) of a sensor_msgs/Image or CompressedImage.

    Raises:
        PictureError: another encoding, sizes that do not fit, a picture that cannot be decoded.
    """
    if _is_compressed(message):
        decoded = _decoded(bytes(message.data), cv2.IMREAD_COLOR_RGB)
        return np.asarray(decoded, dtype=np.uint8)
    encoding = str(message.encoding).lower()
    if encoding not in _CHANNELS:
        raise PictureError(f"colour encoding {_shown(encoding)}; known: {', '.join(_CHANNELS)}")
    picture = _rows(message, np.dtype(np.uint8), _CHANNELS[encoding])
    code = _TO_RGB.get(encoding)
    return np.asarray(picture.copy() if code is None else cv2.cvtColor(picture, code), np.uint8)


def depth_units(message: Any, scale_m: float) -> NDArray[np.uint16]:
    """The depth (h, w) of a sensor_msgs/Image or CompressedImage.

    Millimetres are taken as they come. Metres in floats are rounded to units of ``scale_m``; what
    is not finite, not positive or past 16 bits becomes 0, "no depth".

    Raises:
        PictureError: another encoding, sizes that do not fit, a picture that cannot be decoded.
    """
    if _is_compressed(message):
        return _compressed_depth(message, scale_m)
    encoding = str(message.encoding).lower()
    order = ">" if message.is_bigendian else "<"
    if encoding in _MILLIMETRES:
        return _rows(message, np.dtype(f"{order}u2"), 1).astype(np.uint16)
    if encoding in _METRES:
        return _units_of_metres(_rows(message, np.dtype(f"{order}f4"), 1), scale_m)
    raise PictureError(
        f"depth encoding {_shown(encoding)}; known: {', '.join((*_MILLIMETRES, *_METRES))}"
    )


def depth_scale_m(message: Any) -> float:
    """Metres of one unit that ``depth_units`` gives for a topic, seen from one message."""
    name = message.format if _is_compressed(message) else message.encoding
    return FLOAT_DEPTH_SCALE_M if str(name).lower().startswith(_METRES) else MILLIMETRE_M


def _is_compressed(message: Any) -> bool:
    return hasattr(message, "format")


def _rows(message: Any, kind: np.dtype[Any], channels: int) -> NDArray[Any]:
    """The pixels of an Image, (H, W) or (H, W, channels); rows may be padded."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row_bytes = width * channels * kind.itemsize
    if not (0 < height <= MAX_SIDE_PX and 0 < width <= MAX_SIDE_PX):
        raise PictureError(f"{width}x{height} is no size of a picture")
    if height * width > MAX_PIXELS:
        raise PictureError(f"{width}x{height} is over {MAX_PIXELS} pixels")
    data = np.asarray(message.data, dtype=np.uint8)
    if step < row_bytes or data.size < (height - 1) * step + row_bytes:
        raise PictureError(f"{data.size} bytes in rows of {step} are not {width}x{height}")
    if data.size < height * step:  # the last row without its padding
        data = np.concatenate([data, np.zeros(height * step - data.size, np.uint8)])
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row_bytes])
    pixels = rows.view(kind)
    return pixels if channels == 1 else pixels.reshape(height, width, channels)


def _decoded(data: bytes, flags: int) -> NDArray[Any]:
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error:  # a head that claims more pixels than any camera has
        picture = None
    if picture is None:
        raise PictureError("compressed picture that cannot be decoded")
    if picture.shape[0] * picture.shape[1] > MAX_PIXELS:
        raise PictureError(f"{picture.shape[1]}x{picture.shape[0]} is over {MAX_PIXELS} pixels")
    return np.asarray(picture)


def _compressed_depth(message: Any, scale_m: float) -> NDArray[np.uint16]:
    name = str(message.format).lower()
    data = bytes(message.data)
    if "compresseddepth" not in name:
        picture = _decoded(data, cv2.IMREAD_UNCHANGED)  # a plain 16-bit PNG
    elif "rvl" in name:
        raise PictureError("depth compressed by rvl; known: png")
    else:
        picture = _decoded(data[DEPTH_HEAD_BYTES:], cv2.IMREAD_UNCHANGED)
    if picture.dtype != np.uint16 or picture.ndim != 2:
        raise PictureError("compressed depth is no 16-bit grey picture: colours hold no metres")
    if not name.startswith(_METRES):
        return np.asarray(picture, dtype=np.uint16)
    if "compresseddepth" not in name:
        raise PictureError("float depth in a plain picture")
    a, b = struct.unpack_from("<2f", data, 4)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        metres = np.float32(a) / (picture.astype(np.float32) - np.float32(b))
    return _units_of_metres(np.where(picture == 0, np.float32(0), metres), scale_m)


def _units_of_metres(metres: NDArray[np.float32], scale_m: float) -> NDArray[np.uint16]:
    with np.errstate(invalid="ignore", over="ignore"):
        units = np.rint(metres.astype(np.float64) / scale_m)
        known = (units > 0) & (units <= np.iinfo(np.uint16).max)  # false for NaN too
    return np.where(known, units, 0).astype(np.uint16)


def _shown(text: str) -> str:
    return repr(text[:40])
