"""How large a picture is as it is shown, from its first bytes: nothing is decoded.

Cameras store a picture as the sensor lay and note in EXIF how to turn it. labelme and OpenCV show
it turned, so that is the picture that labels count in, and the size that is meant here.
JPEG, PNG, WebP, BMP and TIFF. Sources: ITU T.81 annex B, the PNG specification 11.2/11.3, the WebP
container specification, TIFF 6.0, EXIF 2.3 section 4.6.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

from detector_training.errors import DatasetError

FORMATS = "JPEG, PNG, WebP, BMP and TIFF"
SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff"})

HEAD_BYTES = 64 << 10
"""Enough for nearly every header; what is longer is read whole."""
_MAX_SEGMENTS = 4096
_TURNED = range(5, 9)
"""EXIF orientations that swap width and height."""
# SOF0..SOF15 without DHT, JPG and DAC, which share the range
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


class Header(NamedTuple):
    """Size as shown, and the EXIF orientation behind it."""

    width: int
    height: int
    orientation: int
    """1 to 8; 1 where nothing is noted."""


def read_header(data: bytes) -> Header | None:
    """Size and orientation of the picture in ``data``; None where it is none that we know."""
    try:
        if data[:2] == b"\xff\xd8":
            found = _jpeg(data)
        elif data[:8] == b"\x89PNG\r\n\x1a\n":
            found = _png(data)
        elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
            found = _webp(data)
        elif data[:2] == b"BM":
            found = _bmp(data)
        elif data[:4] in (b"II*\0", b"MM\0*"):
            found = _tiff(data)
        else:
            return None
    except (struct.error, IndexError):  # cut off
        return None
    if found is None:
        return None
    width, height, orientation = found
    orientation = orientation if 1 <= orientation <= 8 else 1
    return Header(*((height, width) if orientation in _TURNED else (width, height)), orientation)


def picture_header(path: Path) -> Header:
    """Size and orientation of a picture file.

    Raises:
        DatasetError: it cannot be read, or is no picture of a format that we know.
    """
    try:
        with path.open("rb") as file:
            data = file.read(HEAD_BYTES)
            header = read_header(data)
            if header is None and len(data) == HEAD_BYTES:
                # EXIF thumbnails and colour profiles may stand before the size, TIFF's after all
                header = read_header(data + file.read(HEAD_BYTES << 10))
    except OSError as error:
        raise DatasetError(f"picture {path}: {error.strerror}") from None
    if not data:
        raise DatasetError(f"picture {path} is empty")
    if header is None:
        raise DatasetError(f"picture {path} is damaged or none of {FORMATS}")
    return header


def _jpeg(data: bytes) -> tuple[int, int, int] | None:
    at, orientation = 2, 1
    for _ in range(_MAX_SEGMENTS):
        while data[at + 1] == 0xFF:  # fill bytes
            at += 1
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker == 1 or 0xD0 <= marker <= 0xD8:  # these stand alone
            at += 2
            continue
        (length,) = struct.unpack_from(">H", data, at + 2)
        if marker in _START_OF_FRAME:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height, orientation
        if marker == 0xE1 and data[at + 4 : at + 10] == b"Exif\0\0":
            orientation = _exif_orientation(data[at + 10 : at + 2 + length])
        if length < 2 or marker in (0xD9, 0xDA):  # end, or pixels before any size
            return None
        at += 2 + length
    return None


def _png(data: bytes) -> tuple[int, int, int] | None:
    if data[12:16] != b"IHDR":
        return None
    width, height = struct.unpack_from(">II", data, 16)
    at = 8
    for _ in range(_MAX_SEGMENTS):
        if at + 8 > len(data):
            break
        (length,) = struct.unpack_from(">I", data, at)
        kind = data[at + 4 : at + 8]
        if kind == b"eXIf":
            return width, height, _exif_orientation(data[at + 8 : at + 8 + length])
        if kind in (b"IDAT", b"IEND"):
            break
        at += 12 + length
    return width, height, 1


def _webp(data: bytes) -> tuple[int, int, int] | None:
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF, 1
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1, 1
    if kind != b"VP8X":
        return None
    width = int.from_bytes(data[24:27], "little") + 1
    height = int.from_bytes(data[27:30], "little") + 1
    if not data[20] & 0x08:  # no EXIF chunk
        return width, height, 1
    at = 12
    for _ in range(_MAX_SEGMENTS):  # EXIF comes after the pixels
        name = data[at : at + 4]
        (length,) = struct.unpack_from("<I", data, at + 4)
        if name == b"EXIF":
            exif = data[at + 8 : at + 8 + length]
            return width, height, _exif_orientation(exif.removeprefix(b"Exif\0\0"))
        at += 8 + length + length % 2
    return width, height, 1


def _bmp(data: bytes) -> tuple[int, int, int]:
    if struct.unpack_from("<I", data, 14)[0] == 12:  # OS/2
        width, height = struct.unpack_from("<HH", data, 18)
    else:
        width, height = struct.unpack_from("<ii", data, 18)
    return abs(width), abs(height), 1  # a negative height: rows from the top


def _tiff(data: bytes) -> tuple[int, int, int] | None:
    tags = _first_directory(data)
    if 256 not in tags or 257 not in tags:
        return None
    return tags[256], tags[257], tags.get(274, 1)


def _exif_orientation(exif: bytes) -> int:
    try:
        return _first_directory(exif).get(274, 1)
    except (struct.error, IndexError):  # a broken note turns nothing
        return 1


def _first_directory(data: bytes) -> dict[int, int]:
    """Tags of a TIFF's first directory that hold one short or long number."""
    end = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(end + "I", data, 4)
    (count,) = struct.unpack_from(end + "H", data, at)
    tags: dict[int, int] = {}
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind, _ = struct.unpack_from(end + "HHI", data, entry)
        if kind in (3, 4):
            (tags[tag],) = struct.unpack_from(end + ("H" if kind == 3 else "I"), data, entry + 8)
    return tags
