"""Cutting a message into symbols, with RaptorQ repair symbols after them (RFC 6330).

The code is systematic: symbol i of the first k is bytes ``i T`` to ``(i + 1) T`` of the message.
So they are cut and sent at once, and the encoder runs only when they have left.
"""

from __future__ import annotations

import struct

from raptorq import Encoder  # type: ignore[import-untyped]

from rgbd_wire.envelope import MAX_BODY_BYTES, PREFIX_BYTES
from rgbd_wire.tunnel.inner import Inner
from rgbd_wire.tunnel.packet import MAX_DATAGRAM_BYTES, OUTER_BYTES, TAG_BYTES

SHARD_HEAD = struct.Struct("<IHI")
SYMBOL_BYTES = MAX_DATAGRAM_BYTES - OUTER_BYTES - TAG_BYTES - SHARD_HEAD.size
assert SYMBOL_BYTES == 1160
MAX_MESSAGE_BYTES = PREFIX_BYTES + max(MAX_BODY_BYTES.values())
PACKET_ID_BYTES = 4
MESSAGE_IDS = 1 << 24
MAX_SYMBOLS = 1 << 16


def symbols_of(length: int) -> int:
    """How many symbols a message of so many bytes has."""
    return -(-length // SYMBOL_BYTES)


class Outgoing:
    """One message on its way out.

    Args:
        message: 1 to ``MAX_MESSAGE_BYTES`` bytes.
        message_id: 24 bits.
        parity: repair symbols of the first round.
        sent_ns: when it was handed in, own clock.
        budget_ns: how long after that it is of use.
    """

    def __init__(
        self, message: bytes, message_id: int, parity: int, sent_ns: int, budget_ns: int
    ) -> None:
        self.message = message
        self.message_id = message_id
        self.symbols = symbols_of(len(message))
        self.parity = parity
        self.sent_ns = sent_ns
        self.budget_ns = budget_ns
        self.rounds = 0
        """NACKs that were answered."""
        self.begun = False
        self.left_ns = sent_ns
        """When the last symbol of the first round left, own clock."""
        self.parity_ns = 0
        """Parity is held back until then, own clock."""
        self.departures: list[tuple[int, int]] = []
        """When [ns, own clock] and from which symbol on it left, at first and after each pause."""
        self.was_path_free = False
        """Nothing of older messages was on the path when it began to leave."""
        self._next = 0
        self._fresh = self.symbols + parity
        self._head = Inner.SHARD | len(message) << 8
        self._tail = message_id | parity << 24
        self._encoder: Encoder | None = None

    @property
    def left(self) -> int:
        """Symbols of the first round that were not taken yet."""
        return max(0, self.symbols + self.parity - self._next)

    @property
    def data_left(self) -> int:
        """Those of them that are the message itself; they cost no encoding."""
        return max(0, self.symbols - self._next)

    @property
    def next_symbol(self) -> int:
        """The next symbol of the first round."""
        return self._next

    def restarts(self, seen: int) -> list[tuple[int, int]]:
        """Where its sender paused: time since it began [us], symbols from there to the end.

        Args:
            seen: up to which symbol of the first round the receiver looks back.
        """
        if not self.was_path_free:  # when its first symbol arrived does not say when it left
            return []
        first_ns = self.departures[0][0]
        return [((at_ns - first_ns) // 1000, seen - i) for at_ns, i in self.departures[1:]]

    def take(self, count: int) -> list[bytes]:
        """The next shards of the first round: of the message, or parity once those are out."""
        first = self._next
        self.begun = True
        if first < self.symbols:
            after = min(first + count, self.symbols)
            self._next = after
            pack, head, tail, message = SHARD_HEAD.pack, self._head, self._tail, self.message
            return [
                pack(head, i, tail) + message[i * SYMBOL_BYTES : (i + 1) * SYMBOL_BYTES]
                for i in range(first, after)
            ]
        self._next = after = min(first + count, self.symbols + self.parity)
        return self._repair_shards(first, after)

    def drop_rest(self) -> None:
        """It arrived whole: what was not taken yet is of no use."""
        self._next = self.symbols + self.parity

    def take_fresh(self, count: int) -> list[bytes]:
        """Repair shards past the first round: each tells a receiver something new."""
        first = self._fresh
        self._fresh = after = min(first + count, MAX_SYMBOLS)
        return self._repair_shards(first, after)

    def _repair_shards(self, first: int, after: int) -> list[bytes]:
        return [
            SHARD_HEAD.pack(self._head, i, self._tail) + symbol
            for i, symbol in zip(range(first, after), self._repair(first, after), strict=True)
        ]

    def _repair(self, first: int, after: int) -> list[bytes]:
        if self.symbols == 1:  # a copy is as good as a code, and costs nothing
            return [self.message] * (after - first)
        if self._encoder is None:
            self._encoder = Encoder.with_defaults(self.message, SYMBOL_BYTES + PACKET_ID_BYTES)
        packets = self._encoder.get_encoded_packets(after - self.symbols)
        return [packet[PACKET_ID_BYTES:] for packet in packets[first:]]
