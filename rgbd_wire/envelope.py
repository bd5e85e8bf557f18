"""The envelope of every message: magic, version, kind, length, checksum (docs/protocol.md).

::

    offset  bytes  little-endian
    0       4      magic "AERC"
    4       1      version
    5       1      kind
    6       2      reserved, 0
    8       4      length of the body
    12      4      CRC-32 of the 12 bytes before it and the body
    16      -      body
"""

from __future__ import annotations

import struct
import zlib
from enum import IntEnum

from rgbd_wire.errors import DecodeError, Reject

MAGIC = b"AERC"
VERSION = 1
_HEAD = struct.Struct("<4sBBHI")
_CHECKSUM = struct.Struct("<I")
PREFIX_BYTES = _HEAD.size + _CHECKSUM.size


class Kind(IntEnum):
    """What the body is."""

    FRAME = 1
    RESULT = 2
    ACK = 3
    PROBE = 4
    STATUS = 5


MAX_BODY_BYTES = {
    Kind.FRAME: 8 * 1024 * 1024,
    Kind.RESULT: 16 * 1024,
    Kind.ACK: 256,
    Kind.PROBE: 48,
    Kind.STATUS: 512,
}
"""A 640x480 frame weighs about 0.1 MB; the bound fits eight-megapixel pictures of real scenes."""


def seal(kind: Kind, *parts: bytes | memoryview) -> bytes:
    """Put the parts of a body into one envelope."""
    head = _HEAD.pack(MAGIC, VERSION, kind, 0, sum(map(len, parts)))
    checksum = zlib.crc32(head)
    for part in parts:
        checksum = zlib.crc32(part, checksum)
    return b"".join([head, _CHECKSUM.pack(checksum), *parts])


def unseal(data: bytes | memoryview, *kinds: Kind) -> tuple[Kind, memoryview]:
    """Check an envelope and give its kind and body, without copying the body.

    Raises:
        DecodeError: TRUNCATED, WRONG_MAGIC, WRONG_VERSION, WRONG_KIND (not one of ``kinds``),
            BAD_HEADER (a reserved bit is set), OVERSIZED, WRONG_SIZE or CHECKSUM.
    """
    view = memoryview(data)
    if len(view) < PREFIX_BYTES:
        raise DecodeError(Reject.TRUNCATED, f"{len(view)} bytes, an envelope has {PREFIX_BYTES}")
    magic, version, number, reserved, length = _HEAD.unpack_from(view)
    if magic != MAGIC:
        raise DecodeError(Reject.WRONG_MAGIC, f"{magic!r}, expected {MAGIC!r}")
    if version != VERSION:
        raise DecodeError(Reject.WRONG_VERSION, f"version {version}, this side speaks {VERSION}")
    if number not in kinds:
        raise DecodeError(Reject.WRONG_KIND, f"kind {number}, expected {[k.name for k in kinds]}")
    if reserved:
        raise DecodeError(Reject.BAD_HEADER, f"reserved bytes hold {reserved}, expected 0")
    kind = Kind(number)
    body = view[PREFIX_BYTES:]
    if length > MAX_BODY_BYTES[kind]:
        raise DecodeError(Reject.OVERSIZED, f"{length} bytes, at most {MAX_BODY_BYTES[kind]}")
    if len(body) < length:
        raise DecodeError(Reject.TRUNCATED, f"{len(body)} of {length} bytes")
    if len(body) > length:
        raise DecodeError(Reject.WRONG_SIZE, f"{len(body)} bytes after a length of {length}")
    (checksum,) = _CHECKSUM.unpack_from(view, _HEAD.size)
    if zlib.crc32(body, zlib.crc32(view[: _HEAD.size])) != checksum:
        raise DecodeError(Reject.CHECKSUM, "CRC-32 does not match")
    return kind, body
