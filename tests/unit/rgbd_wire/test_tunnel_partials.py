"""Symbols and messages: cut, lost, mixed up, put together, asked for, given up."""

from __future__ import annotations

import random
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.tunnel.errors import Counters
from rgbd_wire.tunnel.inner import Nack, Report
from rgbd_wire.tunnel.partials import (
    MAX_ATTEMPTS,
    MAX_OPEN_BYTES,
    MAX_PARTIALS,
    MAX_PATIENCE_NS,
    REORDER_NS,
    STALE_NS,
    Partials,
)
from rgbd_wire.tunnel.shards import (
    MAX_MESSAGE_BYTES,
    MESSAGE_IDS,
    SHARD_HEAD,
    SYMBOL_BYTES,
    Outgoing,
    symbols_of,
)

MS = 1_000_000


def message_of(length: int, seed: int = 0) -> bytes:
    return random.Random(seed).randbytes(length)


def outgoing(length: int, message_id: int = 0, parity: int = 2) -> Outgoing:
    return Outgoing(message_of(length, message_id), message_id, parity, 0, 100 * MS)


def first_round(out: Outgoing) -> list[bytes]:
    return out.take(out.symbols) + out.take(out.parity)


@dataclass
class Receiver:
    """Partials, what they counted and what they gave."""

    counters: Counters
    partials: Partials
    messages: list[bytes]

    def add(self, *inners: bytes, now_ns: int = 0) -> None:
        for inner in inners:
            message = self.partials.add(inner, now_ns)
            if message is not None:
                self.messages.append(message)
        self.partials.settle(now_ns)

    def words(self, kind: type) -> list:
        return [w for w in self.partials.words if isinstance(w, kind)]

    def counts(self) -> dict[str, int]:
        return {name: n for name, n in self.counters.snapshot().items() if n}


@pytest.fixture
def receiver() -> Receiver:
    return new_receiver()


def new_receiver() -> Receiver:
    counters = Counters()
    return Receiver(counters, Partials(counters), [])


@given(st.integers(1, 30_000), st.integers(0, 10), st.data())
def test_any_k_plus_two_symbols_give_the_message_once(
    length: int, parity: int, data: st.DataObject
) -> None:
    """Any subset with two symbols more than the message has, in any order, with repetitions."""
    out = outgoing(length, parity=parity)
    shards = first_round(out) + out.take_fresh(12)
    least = min(out.symbols + 2, len(shards))
    count = data.draw(st.integers(least, len(shards)))
    chosen = data.draw(st.permutations(shards))[:count]
    again = data.draw(st.lists(st.sampled_from(chosen), max_size=5))
    receiver = new_receiver()
    receiver.add(*chosen, *again)
    assert receiver.messages == [out.message]
    assert receiver.partials.open_bytes == 0
    assert not receiver.counts()


@pytest.mark.parametrize("symbols", [1, 2, 3, 52, 87, 904, 7232])
def test_the_first_symbols_are_the_message(symbols: int) -> None:
    """Cut as it is, at every size: the last symbol is as long as what is left."""
    length = min(symbols * SYMBOL_BYTES - 7, MAX_MESSAGE_BYTES)
    out = outgoing(length)
    assert out.symbols == symbols
    assert b"".join(s[SHARD_HEAD.size :] for s in out.take(symbols)) == out.message
    assert max(len(s) for s in out.take(2)) <= SHARD_HEAD.size + SYMBOL_BYTES


def test_the_largest_message_survives_losses(receiver: Receiver) -> None:
    """8 MiB in one block: 200 symbols are lost and 203 repair symbols make up for them."""
    out = outgoing(MAX_MESSAGE_BYTES, parity=203)
    receiver.add(*first_round(out)[200:])
    assert receiver.messages == [out.message]


def test_fresh_symbols_are_fresh() -> None:
    """What a NACK brings was never sent: numbers go on after the first round."""
    out = outgoing(5000, parity=2)
    numbers = [SHARD_HEAD.unpack_from(s)[1] for s in [*out.take_fresh(2), *out.take_fresh(3)]]
    assert numbers == [7, 8, 9, 10, 11]
    numbers = [SHARD_HEAD.unpack_from(s)[1] for s in first_round(out)]
    assert numbers == [0, 1, 2, 3, 4, 5, 6]


def test_what_arrived_whole_is_not_sent_on() -> None:
    """After a report the rest of the first round is of no use."""
    out = outgoing(5000)
    out.take(out.symbols)
    out.drop_rest()
    assert out.left == 0


def test_a_newer_whole_message_ends_older_ones(receiver: Receiver) -> None:
    """Newest wins: an older frame in pieces is given up and reported as such."""
    old, new = outgoing(5000, 1), outgoing(5000, 2)
    receiver.add(*first_round(old)[:2])
    receiver.add(*first_round(new))
    receiver.add(*first_round(old)[2:])
    assert receiver.messages == [new.message]
    assert receiver.counts() == {"evicted": 1}
    assert [(r.message_id, r.whole) for r in receiver.words(Report)] == [(2, True), (1, False)]


def test_a_small_message_ends_nothing(receiver: Receiver) -> None:
    """A probe between two halves of a frame leaves it alone."""
    frame, probe = outgoing(5000, 1), outgoing(64, 2, parity=0)
    shards = first_round(frame)
    receiver.add(*shards[:2], *probe.take(1), *shards[2:])
    assert receiver.messages == [probe.message, frame.message]


def test_message_ids_wrap_around(receiver: Receiver) -> None:
    """After the highest id comes 0, and an old one is still an old one."""
    for number in (MESSAGE_IDS // 3, 2 * MESSAGE_IDS // 3, MESSAGE_IDS - 1, 0):
        receiver.add(*outgoing(10, number, parity=0).take(1))
    receiver.add(*outgoing(10, MESSAGE_IDS - 1, parity=0).take(1))
    assert len(receiver.messages) == 4


def test_a_nack_says_how_much_lacks(receiver: Receiver) -> None:
    """All was sent, three symbols more than the parity were lost: asked for in a millisecond."""
    out = outgoing(20 * SYMBOL_BYTES, parity=2)
    shards = first_round(out)
    receiver.add(*shards[5:], now_ns=10 * MS)
    due_ns = receiver.partials.deadline_ns
    assert due_ns == 10 * MS + REORDER_NS
    receiver.partials.tick(due_ns - 1)
    assert not receiver.words(Nack)
    receiver.partials.tick(due_ns)
    assert receiver.words(Nack) == [Nack(0, 1, 3 + 1, 0)]
    receiver.add(*out.take_fresh(4), now_ns=12 * MS)
    assert receiver.messages == [out.message]


def test_a_nack_comes_as_soon_as_parity_cannot_do(receiver: Receiver) -> None:
    """More gaps than parity in the middle of a message: it says what it expects besides."""
    out = outgoing(20 * SYMBOL_BYTES, parity=2)
    shards = first_round(out)
    receiver.add(shards[0], now_ns=0)
    receiver.add(*shards[6:10], now_ns=MS)
    receiver.partials.tick(MS + REORDER_NS)
    (nack,) = receiver.words(Nack)
    assert (nack.wanted, nack.expected) == (15 + 1, 12)


def test_silence_after_a_part_leads_to_a_nack(receiver: Receiver) -> None:
    """The tail never came: after at most 20 ms all that lacks is asked for."""
    out = outgoing(20 * SYMBOL_BYTES, parity=2)
    receiver.add(*first_round(out)[:12], now_ns=0)
    receiver.partials.tick(MAX_PATIENCE_NS)
    (nack,) = receiver.words(Nack)
    assert (nack.wanted, nack.expected) == (8 + 1, 10)


def test_two_rounds_and_then_it_is_stale(receiver: Receiver) -> None:
    """The second NACK waits for a round trip; there is no third, and later nothing is kept."""
    receiver.partials.srtt_ns = 40 * MS
    receiver.add(*first_round(outgoing(5000))[:3], now_ns=0)
    times = []
    now_ns = 0
    while (due_ns := receiver.partials.deadline_ns) is not None:
        now_ns = max(now_ns + 1, due_ns)
        receiver.partials.tick(now_ns)
        times += [now_ns] * (len(receiver.words(Nack)) - len(times))
    assert [nack.round for nack in receiver.words(Nack)] == [1, 2]
    assert times[1] - times[0] >= 50 * MS
    assert now_ns == STALE_NS
    assert receiver.counts() == {"stale": 1}
    assert receiver.partials.open_bytes == 0


def test_the_report_tells_the_rate_of_the_path(receiver: Receiver) -> None:
    """Bytes after the first batch over the time from the first to the last, and what was lost."""
    out = outgoing(20 * SYMBOL_BYTES, parity=2)
    shards = first_round(out)
    del shards[3]
    for i, shard in enumerate(shards):
        receiver.add(shard, now_ns=i * MS)
    (report,) = receiver.words(Report)
    assert report == Report(0, True, 20, 1, 19 * 1228, 19_000)


def test_what_contradicts_itself_is_refused(receiver: Receiver) -> None:
    """Lengths out of bounds, symbols of another size, shards that disagree: counted, not kept."""
    pack = SHARD_HEAD.pack
    bad = [
        b"\x01",
        pack(1, 0, 0) + b"x",  # of no length
        pack(1 | (MAX_MESSAGE_BYTES + 1) << 8, 0, 0) + b"x" * SYMBOL_BYTES,
        pack(1 | 10 << 8, 0, 0) + b"x" * 11,  # longer than its message
        pack(1 | 5000 << 8, 0, 1) + b"x" * (SYMBOL_BYTES - 1),
        pack(1 | 5000 << 8, 0, 1 | 9 << 24) + b"x" * SYMBOL_BYTES,  # other parity than before
        pack(1 | 5001 << 8, 0, 1) + b"x" * SYMBOL_BYTES,  # other length than before
    ]
    receiver.add(*bad)
    assert receiver.counts() == {"bad_shard": len(bad)}
    assert receiver.messages == []


def test_symbols_of_no_message_are_given_up(receiver: Receiver) -> None:
    """A peer whose symbols never decode costs eight attempts and no more."""
    length = 40 * SYMBOL_BYTES
    head, noise = 1 | length << 8, random.Random(1)
    shards = [SHARD_HEAD.pack(head, 300, 0) + bytes(SYMBOL_BYTES) for _ in range(100)]
    receiver.add(*shards)
    assert symbols_of(receiver.partials.open_bytes) == 40
    for esi in range(300, 400):
        receiver.add(SHARD_HEAD.pack(head, esi, 0) + noise.randbytes(SYMBOL_BYTES))
    assert len(receiver.messages) + receiver.counts().get("undecodable", 0) == 1
    assert MAX_ATTEMPTS < 10
    assert receiver.partials.open_bytes == 0


SHARDS = st.builds(
    lambda length, esi, number, parity, cut: (
        SHARD_HEAD.pack(1 | length << 8, esi, number | parity << 24)
        + bytes(max(0, min(SYMBOL_BYTES, length - esi * SYMBOL_BYTES) - cut))
    ),
    st.one_of(st.integers(0, 9000), st.integers(0, 2**24 - 1)),
    st.one_of(st.integers(0, 9), st.integers(0, 65535)),
    st.one_of(st.integers(0, 9), st.integers(0, MESSAGE_IDS - 1)),
    st.integers(0, 255),
    st.sampled_from([0, 0, 0, 1]),
)


@given(st.lists(st.tuples(SHARDS, st.integers(0, 60 * MS)), max_size=120))
def test_no_sequence_of_shards_keeps_more_than_the_bound(
    steps: list[tuple[bytes, int]],
) -> None:
    """Whatever an authentic peer sends: bounded pieces, bounded words, and silence clears all."""
    receiver = new_receiver()
    now_ns = 0
    for shard, step_ns in steps:
        now_ns += step_ns
        receiver.add(shard, now_ns=now_ns)
        receiver.partials.tick(now_ns)
        assert receiver.partials.open_bytes <= MAX_OPEN_BYTES
        assert len(receiver.partials._open) <= MAX_PARTIALS
        assert len(receiver.partials.words) <= 2 * MAX_PARTIALS + 1
        receiver.partials.words.clear()
    for _ in range(4 * MAX_PARTIALS):
        now_ns += STALE_NS
        receiver.partials.tick(now_ns)
    assert receiver.partials.open_bytes == 0
