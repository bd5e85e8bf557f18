"""What a picture file says about itself in its header: looked at before anything is decoded."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import StrEnum

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_SIGNATURE = b"\xff\xd8\xff"
_IHDR = struct.Struct(">I4sIIBB")
_SOF = struct.Struct(">BHHB")
# Start-of-frame markers, all but DHT (C4), JPG (C8) and DAC (CC) (ITU-T T.81, table B.1)
_SOF_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_ALONE = frozenset({0x01, *range(0xD0, 0xD8)})  # markers without a length
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type; 3 is a palette
_PALETTE = 3


class PictureKind(StrEnum):
    """The two kinds of file that are taken."""

    PNG = "PNG"
    JPEG = "JPEG"


@dataclass(frozen=True, slots=True)
class PictureHeader:
    """Kind, size and sample format of a picture file."""

    kind: PictureKind
    width: int
    height: int
    bits: int
    """Per sample."""
    channels: int
    palette: bool = False


def read_header(data: bytes) -> PictureHeader | None:
    """The header of a PNG or JPEG file; None: it is neither, or cut off before its size."""
    if data.startswith(PNG_SIGNATURE):
        return _png(data)
    if data.startswith(JPEG_SIGNATURE):
        return _jpeg(data)
    return None


def _png(data: bytes) -> PictureHeader | None:
    if len(data) < len(PNG_SIGNATURE) + _IHDR.size:
        return None
    _, chunk, width, height, bits, color_type = _IHDR.unpack_from(data, len(PNG_SIGNATURE))
    if chunk != b"IHDR" or color_type not in _PNG_CHANNELS:
        return None
    channels = _PNG_CHANNELS[color_type]
    return PictureHeader(
        PictureKind.PNG, width, height, bits, channels, palette=color_type == _PALETTE
    )


def _jpeg(data: bytes) -> PictureHeader | None:
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
        elif marker in _ALONE:
            at += 2
        elif marker in _SOF_MARKERS:
            if at + 4 + _SOF.size > len(data):
                return None
            bits, height, width, channels = _SOF.unpack_from(data, at + 4)
            return PictureHeader(PictureKind.JPEG, width, height, bits, channels)
        else:
            at += 2 + max(2, int.from_bytes(data[at + 2 : at + 4], "big"))
    return None
