"""Messages that are still in pieces: put together, asked for again, given up. All bounded."""

from __future__ import annotations

from itertools import islice

from raptorq import Decoder  # type: ignore[import-untyped]

from rgbd_wire.tunnel.errors import Counters, Refusal
from rgbd_wire.tunnel.inner import MAX_ROUNDS, Nack, Report, Word
from rgbd_wire.tunnel.replay_window import ReplayWindow
from rgbd_wire.tunnel.shards import (
    MAX_MESSAGE_BYTES,
    MESSAGE_IDS,
    PACKET_ID_BYTES,
    SHARD_HEAD,
    SYMBOL_BYTES,
    symbols_of,
)

MAX_PARTIALS = 4
MAX_OPEN_BYTES = 2 * MAX_MESSAGE_BYTES
"""Of all partial messages of a session together."""
MAX_ATTEMPTS = 8
"""Decodings of one message. With k symbols 1 in 100 fails, with each more 1 in 100 of those."""
REORDER_NS = 1_000_000
"""A gap older than this is a loss, not a datagram that was overtaken."""
MIN_PATIENCE_NS, MAX_PATIENCE_NS = 3_000_000, 20_000_000
STALE_NS = 400_000_000
SHARD_HEAD_BYTES = SHARD_HEAD.size
_unpack = SHARD_HEAD.unpack_from
_KEYS = MESSAGE_IDS - 1
_FULL_BYTES = SHARD_HEAD_BYTES + SYMBOL_BYTES
DATAGRAM_HEADS_BYTES = 68
"""What a symbol weighs more on the wire: IPv4, UDP, outer, tag, inner."""


class _Partial:
    __slots__ = (
        "attempts",
        "batches",
        "data",
        "decoder",
        "deadline_ns",
        "first_ns",
        "first_round",
        "got",
        "got_data",
        "got_first",
        "head",
        "highest",
        "key",
        "last_first_ns",
        "last_ns",
        "length",
        "message_id",
        "parity",
        "repair",
        "rounds",
        "symbols",
        "tail",
        "train_symbols",
    )

    def __init__(self, head: int, tail: int, message_id: int, now_ns: int) -> None:
        self.head = head
        self.tail = tail
        self.key = tail & _KEYS
        self.message_id = message_id  # without wrapping round
        self.length = head >> 8
        self.symbols = symbols_of(self.length)
        self.parity = tail >> 24
        self.first_round = self.symbols + self.parity
        self.data: list[bytes | None] = [None] * self.symbols
        self.repair: dict[int, bytes] = {}
        self.decoder: Decoder | None = None
        self.attempts = 0
        self.got = 0
        self.got_data = 0
        self.got_first = 0
        self.highest = -1
        self.rounds = 0
        self.batches = 1
        self.train_symbols = 0
        self.first_ns = self.last_ns = self.last_first_ns = now_ns
        self.deadline_ns = now_ns + MAX_PATIENCE_NS

    def lost(self) -> int:
        """Symbols of the first round that should have been here."""
        return self.highest + 1 - self.got_first

    def report(self, *, whole: bool) -> Report:
        return Report(
            self.key,
            whole,
            self.got_first,
            self.lost() if whole else self.first_round - self.got_first,
            self.train_symbols * (SYMBOL_BYTES + DATAGRAM_HEADS_BYTES),
            (self.last_first_ns - self.first_ns) // 1000,
        )


class Partials:
    """Puts the messages of one direction of one session together.

    Newest wins: a whole message of several symbols ends every older one that is in pieces.
    """

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._open: dict[int, _Partial] = {}
        self._newest: _Partial | None = None
        self._done = ReplayWindow(256)
        self.words: list[Word] = []
        """What the sender is to be told; whoever sends it empties the list."""
        self.srtt_ns = 0
        """Round trip, 0: not known."""

    @property
    def open_bytes(self) -> int:
        """Lengths of the messages that are in pieces, together."""
        return sum(p.length for p in self._open.values())

    @property
    def deadline_ns(self) -> int | None:
        """When ``tick`` is due; None: nothing is in pieces."""
        return min((p.deadline_ns for p in self._open.values()), default=None)

    def add(self, inner: bytes, now_ns: int) -> bytes | None:
        """Take a shard; the message if it is whole now.

        All datagrams of one batch of the socket come with the same ``now_ns``.
        """
        if len(inner) <= SHARD_HEAD_BYTES:
            self._counters.count(Refusal.BAD_SHARD)
            return None
        head, esi, tail = _unpack(inner)
        symbol = inner[SHARD_HEAD_BYTES:]
        partial = self._newest
        if partial is None or partial.tail != tail or partial.head != head:
            partial = self._open.get(tail & _KEYS)
            if partial is None:
                return self._first(head, tail, symbol, esi, now_ns)
            if partial.head != head or partial.tail != tail:
                self._counters.count(Refusal.BAD_SHARD)
                return None
        if not self._place(partial, esi, symbol, now_ns) or partial.got < partial.symbols:
            return None
        return self._finish(partial, esi, symbol)

    def add_run(self, inners: list[bytes], start: int, now_ns: int) -> int:
        """Take full symbols of the newest message as long as they follow one another.

        Nearly all of a frame comes this way, so it does the least for each.

        Returns:
            The index of the first one that it did not take; ``add`` is for that.
        """
        partial = self._newest
        if partial is None:
            return start
        data, head, tail = partial.data, partial.head, partial.tail
        # Never the last one: nothing is whole after a run
        first = expected = partial.highest + 1
        last = min(partial.symbols - 1, first + partial.symbols - 1 - partial.got)
        unpack, index = _unpack, start
        for inner in islice(inners, start, None):
            if expected >= last or len(inner) != _FULL_BYTES:
                break
            if unpack(inner) != (head, expected, tail) or data[expected] is not None:
                break
            data[expected] = inner[SHARD_HEAD_BYTES:]
            expected += 1
            index += 1
        if count := index - start:
            partial.got += count
            partial.got_data += count
            self._note(partial, count, expected - 1, now_ns)
        return index

    def _first(self, head: int, tail: int, symbol: bytes, esi: int, now_ns: int) -> bytes | None:
        """A shard of a message that is not in pieces yet."""
        message_id = self._unwrap(tail & _KEYS)
        if not self._done.is_new(message_id):
            return None  # parity of a whole message, as a rule: no fault
        length = head >> 8
        if not 0 < length <= MAX_MESSAGE_BYTES:
            self._counters.count(Refusal.BAD_SHARD)
        elif length <= SYMBOL_BYTES:
            return self._single(message_id, length, symbol)
        elif (partial := self._begin(head, tail, message_id, now_ns)) is not None:
            self._place(partial, esi, symbol, now_ns)
        return None

    def _single(self, message_id: int, length: int, symbol: bytes) -> bytes | None:
        """A message of one symbol: nothing to put together."""
        if len(symbol) != length:
            self._counters.count(Refusal.BAD_SHARD)
            return None
        self._done.mark(message_id)
        return symbol

    def _place(self, partial: _Partial, esi: int, symbol: bytes, now_ns: int) -> bool:
        """Keep a symbol; False: it is none, or was here already."""
        last = partial.symbols - 1
        size = SYMBOL_BYTES if esi != last else partial.length - last * SYMBOL_BYTES
        if len(symbol) != size:
            self._counters.count(Refusal.BAD_SHARD)
            return False
        if esi <= last:
            if partial.data[esi] is not None:
                return False
            partial.data[esi] = symbol
            partial.got_data += 1
        elif esi in partial.repair:
            return False
        else:
            partial.repair[esi] = symbol
        partial.got += 1
        if esi < partial.first_round:
            self._note(partial, 1, esi, now_ns)
        elif now_ns != partial.last_ns:
            partial.batches += 1
            partial.last_ns = now_ns
        return True

    @staticmethod
    def _note(partial: _Partial, count: int, esi: int, now_ns: int) -> None:
        """Symbols of the first round came, the last of them ``esi``."""
        partial.got_first += count
        if esi > partial.highest:
            partial.highest = esi
        if now_ns != partial.last_ns:
            partial.batches += 1
            partial.last_ns = now_ns
        partial.last_first_ns = now_ns
        if now_ns != partial.first_ns:
            partial.train_symbols += count

    def settle(self, now_ns: int) -> None:
        """After a batch: when to ask for more of what is still in pieces."""
        for partial in self._open.values():
            if partial.last_ns != now_ns or partial.rounds:
                continue
            if partial.lost() > partial.parity:  # the first round cannot be enough any more
                partial.deadline_ns = min(partial.deadline_ns, now_ns + REORDER_NS)
            elif partial.highest == partial.first_round - 1:
                partial.deadline_ns = now_ns + REORDER_NS
            else:
                partial.deadline_ns = now_ns + self._patience_ns(partial)

    def tick(self, now_ns: int) -> None:
        """Ask for more of what is due, give up what is stale."""
        for partial in list(self._open.values()):
            if now_ns < partial.deadline_ns:
                continue
            if now_ns - partial.last_ns >= STALE_NS:
                self._give_up(partial, Refusal.STALE)
            elif partial.rounds < MAX_ROUNDS:
                self._ask(partial, now_ns)
            else:
                partial.deadline_ns = partial.last_ns + STALE_NS

    def _ask(self, partial: _Partial, now_ns: int) -> None:
        """Ask for what lacks, and a little more."""
        lacking = max(1, partial.symbols - partial.got)
        expected = partial.first_round - 1 - partial.highest
        partial.rounds += 1
        partial.deadline_ns = now_ns + self.srtt_ns + self.srtt_ns // 4 + self._patience_ns(partial)
        # What is sent again may be lost again
        margin = 1 + max(1, lacking - expected) // 4
        self.words.append(
            Nack(partial.key, partial.rounds, min(lacking + margin, 65535), min(expected, 65535))
        )

    def _patience_ns(self, partial: _Partial) -> int:
        """How long the next batch may take: three times as long as those so far took."""
        apart_ns = (partial.last_ns - partial.first_ns) // max(1, partial.batches - 1)
        return min(max(3 * apart_ns, MIN_PATIENCE_NS), MAX_PATIENCE_NS)

    def _unwrap(self, key: int) -> int:
        """The message id that is nearest to the newest one, of its lower 24 bits."""
        newest = max(self._done.newest, max((p.message_id for p in self._open.values()), default=0))
        half = MESSAGE_IDS // 2
        return newest + (key - newest + half) % MESSAGE_IDS - half

    def _begin(self, head: int, tail: int, message_id: int, now_ns: int) -> _Partial | None:
        partial = _Partial(head, tail, message_id, now_ns)
        while self._open and (
            len(self._open) >= MAX_PARTIALS or self.open_bytes + partial.length > MAX_OPEN_BYTES
        ):
            oldest = min(self._open.values(), key=lambda p: p.message_id)
            if oldest.message_id > message_id:
                self._counters.count(Refusal.EVICTED)
                return None
            self._give_up(oldest, Refusal.EVICTED)
        self._open[partial.key] = self._newest = partial
        return partial

    def _finish(self, partial: _Partial, esi: int, symbol: bytes) -> bytes | None:
        message = self._decode(partial, esi, symbol)
        if message is None:
            if partial.attempts >= MAX_ATTEMPTS:
                self._give_up(partial, Refusal.UNDECODABLE)
            return None
        del self._open[partial.key]
        if self._newest is partial:
            self._newest = None
        self._done.mark(partial.message_id)
        self.words.append(partial.report(whole=True))
        for older in [p for p in self._open.values() if p.message_id < partial.message_id]:
            self._give_up(older, Refusal.EVICTED)
        return message

    def _decode(self, partial: _Partial, esi: int, symbol: bytes) -> bytes | None:
        if partial.got_data == partial.symbols:
            return b"".join(s for s in partial.data if s is not None)
        partial.attempts += 1
        if partial.decoder is None:
            partial.decoder = Decoder.with_defaults(partial.length, SYMBOL_BYTES + PACKET_ID_BYTES)
            have = {i: s for i, s in enumerate(partial.data) if s is not None} | partial.repair
        else:
            have = {esi: symbol}
        message: bytes | None = None
        for i, s in have.items():
            packet = i.to_bytes(PACKET_ID_BYTES, "big") + s.ljust(SYMBOL_BYTES, b"\0")
            message = partial.decoder.decode(packet)
            if message is not None:
                break
        return message if message is not None and len(message) == partial.length else None

    def _give_up(self, partial: _Partial, reason: Refusal) -> None:
        del self._open[partial.key]
        if self._newest is partial:
            self._newest = None
        if self._done.is_new(partial.message_id):
            self._done.mark(partial.message_id)
        self._counters.count(reason)
        self.words.append(partial.report(whole=False))
