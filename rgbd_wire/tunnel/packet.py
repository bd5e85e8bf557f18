"""The outside of every datagram: type, session, packet number.

::

    sealed datagrams (UP, DOWN)
    offset  bytes  little-endian
    0       1      version << 4 | type
    1       8      session id
    9       5      packet number, per direction, from 0
    14      -      ciphertext of the inner message, then 16 bytes of tag

The 14 bytes are the additional data of the AEAD. UP and DOWN differ in type and in key, so that
nothing reflected is ever taken.
"""

from __future__ import annotations

import struct
from enum import IntEnum

from rgbd_wire.tunnel.errors import Refusal, TunnelError

VERSION = 1
MAX_DATAGRAM_BYTES = 1200
"""Payload of UDP: what gets through any path that carries IPv6, without fragments."""
OUTER_BYTES = 14
TAG_BYTES = 16
MAX_PACKET_NUMBER = 2**40 - 1
RESET_BYTES = 9
_RESET = struct.Struct("<BQ")


class Type(IntEnum):
    """What a datagram is."""

    INIT = 1
    COOKIE = 2
    HELLO = 3
    WELCOME = 4
    RESET = 5
    UP = 6
    """Sealed, from the drone to the worker."""
    DOWN = 7
    """Sealed, from the worker to the drone."""


def first_byte(kind: Type) -> int:
    """The byte that every datagram of a type begins with."""
    return VERSION << 4 | kind


def type_of(datagram: bytes | memoryview) -> Type:
    """Type of a datagram.

    Raises:
        TunnelError: MALFORMED or WRONG_VERSION.
    """
    if not datagram:
        raise TunnelError(Refusal.MALFORMED, "an empty datagram")
    version, number = divmod(datagram[0], 16)
    if version != VERSION:
        raise TunnelError(Refusal.WRONG_VERSION, f"version {version}, this side speaks {VERSION}")
    try:
        return Type(number)
    except ValueError:
        raise TunnelError(Refusal.MALFORMED, f"type {number}") from None


def outer_prefix(kind: Type, session: int) -> bytes:
    """The first 9 bytes of a sealed datagram; they are the same for a whole session."""
    return _RESET.pack(first_byte(kind), session)


def pack_reset(session: int) -> bytes:
    """A RESET: this worker knows no such session. Nobody signs it, so it is only a hint."""
    return _RESET.pack(first_byte(Type.RESET), session)


def parse_reset(datagram: bytes | memoryview) -> int:
    """The session that a RESET is about.

    Raises:
        TunnelError: MALFORMED.
    """
    if len(datagram) != RESET_BYTES:
        raise TunnelError(Refusal.MALFORMED, f"a RESET of {len(datagram)} bytes")
    return int.from_bytes(datagram[1:9], "little")
