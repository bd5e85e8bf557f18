"""What a sealed datagram says inside: shards of messages, and the few words of the tunnel itself.

::

    SHARD    u8 1, u24 length of the message, u16 symbol id, u24 message id, u8 parity symbols
             that were sent with it, symbol
    NACK     u8 2, u24 message id, u8 round (1, 2), u16 symbols wanted, u16 symbols expected
    REPORT   u8 3, u24 message id, u8 whole (0, 1), u16 symbols received, u16 symbols lost,
             u32 bytes after the first batch, u32 time from the first to the last batch [us]
    GOODBYE  u8 4
    PING     u8 5, u64 stamp [ns, sender's clock], u32 sender's round trip [us],
             u40 highest packet number that the sender received + 1, u40 packets that it received
    PONG     u8 6, the rest as in PING, the stamp echoed
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeAlias

from rgbd_wire.tunnel.errors import Refusal, TunnelError

_NACK = struct.Struct("<IBHH")
_REPORT = struct.Struct("<IBHHII")
_PING = struct.Struct("<BQI")
_PING_BYTES = _PING.size + 10
MAX_ROUNDS = 2
_MAX_U32 = 2**32 - 1


class Inner(IntEnum):
    """First byte of an inner message."""

    SHARD = 1
    NACK = 2
    REPORT = 3
    GOODBYE = 4
    PING = 5
    PONG = 6


@dataclass(frozen=True, slots=True)
class Nack:
    """A receiver wants more symbols of a message."""

    message_id: int
    """Its lower 24 bits."""
    round: int
    """1, or 2 when what the first one asked for was not enough."""
    wanted: int
    """How many symbols lack, and a few more."""
    expected: int
    """How many of the first round come after the last one that is here; they may be on their way,
    which the sender knows better."""


@dataclass(frozen=True, slots=True)
class Report:
    """What a receiver saw of one message of several symbols."""

    message_id: int
    """Its lower 24 bits."""
    whole: bool
    """It was put together; False: given up."""
    received: int
    lost: int
    """Symbols of the first round that are known to be missing."""
    train_bytes: int
    """Bytes of datagrams after the first batch; over ``train_us`` they give the path's rate."""
    train_us: int
    """0: everything came in one batch."""


@dataclass(frozen=True, slots=True)
class Ping:
    """A sign of life, there or back."""

    back: bool
    """A PONG."""
    stamp_ns: int
    """Of the clock of the side that sent the PING."""
    srtt_us: int
    """Round trip that the sender of this has measured; 0: none yet."""
    next_number: int
    """Highest packet number that the sender of this received, plus one."""
    count: int
    """Packets that the sender of this received."""


@dataclass(frozen=True, slots=True)
class Goodbye:
    """A worker drains: no more frames to it, answers still come."""


Word: TypeAlias = Nack | Report | Ping | Goodbye


def pack_word(word: Word) -> bytes:
    """The bytes of anything but a shard."""
    match word:
        case Nack():
            return _NACK.pack(
                Inner.NACK | word.message_id << 8, word.round, word.wanted, word.expected
            )
        case Report():
            return _REPORT.pack(
                Inner.REPORT | word.message_id << 8,
                word.whole,
                min(word.received, 65535),
                min(word.lost, 65535),
                min(word.train_bytes, _MAX_U32),
                min(word.train_us, _MAX_U32),
            )
        case Ping():
            kind = Inner.PONG if word.back else Inner.PING
            head = _PING.pack(kind, word.stamp_ns, min(word.srtt_us, _MAX_U32))
            numbers = word.next_number.to_bytes(5, "little") + word.count.to_bytes(5, "little")
            return head + numbers
        case Goodbye():
            return bytes([Inner.GOODBYE])


def parse_word(inner: bytes) -> Word:
    """Anything but a shard.

    Raises:
        TunnelError: MALFORMED.
    """
    match inner[0], len(inner):
        case Inner.NACK, _NACK.size:
            head, number, wanted, expected = _NACK.unpack(inner)
            if 1 <= number <= MAX_ROUNDS and wanted > 0:
                return Nack(head >> 8, number, wanted, expected)
        case Inner.REPORT, _REPORT.size:
            head, whole, received, lost, train_bytes, train_us = _REPORT.unpack(inner)
            if whole <= 1:
                return Report(head >> 8, bool(whole), received, lost, train_bytes, train_us)
        case ((Inner.PING | Inner.PONG), size) if size == _PING_BYTES:
            kind, stamp_ns, srtt_us = _PING.unpack_from(inner)
            return Ping(
                kind == Inner.PONG,
                stamp_ns,
                srtt_us,
                int.from_bytes(inner[13:18], "little"),
                int.from_bytes(inner[18:], "little"),
            )
        case Inner.GOODBYE, 1:
            return Goodbye()
    raise TunnelError(Refusal.MALFORMED, f"an inner message {inner[0]} of {len(inner)} bytes")
