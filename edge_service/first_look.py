"""A look at a frame's header alone, for those that are turned away whatever they hold."""

from __future__ import annotations

import struct

from rgbd_wire.envelope import PREFIX_BYTES
from rgbd_wire.errors import DecodeError, Reject
from rgbd_wire.frame_codec import MAX_HEADER_BYTES
from rgbd_wire.messages import FrameHeader, decode_header

_LENGTH = struct.Struct("<I")


def look(data: bytes | memoryview) -> FrameHeader:
    """The header of a FRAME message whose checksum nobody has looked at.

    It says whom to answer and which frame, and no more: a picture of 8 MB costs no more than a
    small one.

    Raises:
        DecodeError: TRUNCATED, OVERSIZED or BAD_HEADER.
    """
    view = memoryview(data)
    start = PREFIX_BYTES + _LENGTH.size
    if len(view) < start:
        raise DecodeError(Reject.TRUNCATED, f"{len(view)} bytes, a header begins at {start}")
    (length,) = _LENGTH.unpack_from(view, PREFIX_BYTES)
    if length > MAX_HEADER_BYTES:
        raise DecodeError(Reject.OVERSIZED, f"header of {length} bytes, at most {MAX_HEADER_BYTES}")
    return decode_header(view[start : start + length])
