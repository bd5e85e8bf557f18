"""One frame from files that somebody hands in, over HTTP or on the command line.

Sizes are read from the files' headers and compared with the camera before anything is decoded, so
that a small file that claims a huge picture costs nothing.
"""

from __future__ import annotations

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from edge_service.errors import InputError
from edge_service.picture_header import PictureHeader, PictureKind, read_header
from rgbd_wire.camera import CameraIntrinsics, camera_from_json
from rgbd_wire.color import decode_color
from rgbd_wire.errors import CameraFileError, DecodeError
from rgbd_wire.frame import RgbdFrame

END_OF_JPEG = b"\xff\xd9"
MAX_PADDING_BYTES = 1024
"""What cameras and phones write behind a JPEG's end; where there is more, no end is looked for."""


def frame_of_files(color: bytes, depth: bytes | None, camera_json: bytes | str) -> RgbdFrame:
    """A frame of a colour file, perhaps a depth file, and a camera JSON.

    Args:
        color: JPEG, or PNG with 8 bits per sample.
        depth: PNG with one channel of 16 bits in units of the camera's ``depth_scale_m``; None or
            empty: there is no depth.
        camera_json: as ``rgbd_wire.camera.camera_from_json`` takes it.

    Raises:
        InputError: with the field at fault and one sentence.
    """
    try:
        camera = camera_from_json(camera_json)
    except CameraFileError as error:
        raise InputError("camera", str(error)) from None
    color_rgb = _color(color, camera.color)
    depth_units = _depth(depth, camera.depth) if depth else None
    return RgbdFrame(color_rgb, depth_units, camera, 0, None)


def _color(data: bytes, camera: CameraIntrinsics) -> NDArray[np.uint8]:
    header = _checked_header("color", data, camera)
    if header.kind is PictureKind.JPEG:
        if header.channels != 3:
            raise InputError("color", f"the JPEG has {header.channels} channels and must have 3")
        end = data.rfind(END_OF_JPEG, max(0, len(data) - MAX_PADDING_BYTES - len(END_OF_JPEG)))
        if end < 0:  # libjpeg would fill the rest with grey
            raise InputError("color", "the JPEG is cut off")
        try:
            return decode_color(data[: end + len(END_OF_JPEG)], camera.width, camera.height)
        except DecodeError as error:
            raise InputError("color", error.detail) from None
    if header.bits != 8 or header.palette or header.channels not in (3, 4):
        raise InputError("color", f"the PNG is {_samples(header)} and must be 8-bit RGB or RGBA")
    pixels = np.empty((header.height, header.width, header.channels), np.uint8)
    _decode_png("color", data, pixels)
    return np.ascontiguousarray(pixels[..., :3])


def _depth(data: bytes, camera: CameraIntrinsics) -> NDArray[np.uint16]:
    header = _checked_header("depth", data, camera)
    if header.kind is not PictureKind.PNG or header.bits != 16 or header.channels != 1:
        raise InputError(
            "depth", f"the {header.kind} is {_samples(header)} and must be a 16-bit grey PNG"
        )
    depth_units = np.empty((header.height, header.width), np.uint16)
    _decode_png("depth", data, depth_units)
    return depth_units


def _checked_header(field: str, data: bytes, camera: CameraIntrinsics) -> PictureHeader:
    header = read_header(data)
    if header is None:
        kinds = "a PNG" if field == "depth" else "a JPEG or PNG"
        raise InputError(field, f"{len(data)} bytes that are not {kinds} file")
    if (header.width, header.height) != (camera.width, camera.height):
        raise InputError(
            field,
            f"the picture is {header.width}x{header.height}, "
            f"the camera JSON says {camera.width}x{camera.height}",
        )
    return header


def _samples(header: PictureHeader) -> str:
    if header.palette:
        return "a palette picture"
    names = {1: "grey", 2: "grey with alpha", 3: "RGB", 4: "RGBA"}
    return f"{header.bits}-bit {names.get(header.channels, f'{header.channels}-channel')}"


def _decode_png(field: str, data: bytes, out: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    try:
        imagecodecs.png_decode(data, out=out)
    except (imagecodecs.PngError, ValueError) as error:
        raise InputError(field, f"the PNG cannot be decoded: {error}") from None
