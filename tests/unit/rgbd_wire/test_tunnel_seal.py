"""Sealing, opening, and the window against replays."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.tunnel.errors import Counters, Refusal, TunnelError
from rgbd_wire.tunnel.packet import Type, pack_reset, parse_reset, type_of
from rgbd_wire.tunnel.replay_window import ReplayWindow
from rgbd_wire.tunnel.seal import Cipher, DirectionKey, Opener, Sealer, choose_cipher

KEY = DirectionKey(bytes(range(32)), b"prefix!")
BOTH = Cipher.AES_256_GCM | Cipher.CHACHA20_POLY1305
INNER = st.binary(min_size=1, max_size=1170)
CIPHERS = st.sampled_from([Cipher.AES_256_GCM, Cipher.CHACHA20_POLY1305])


def open_one(opener: Opener, datagram: bytes) -> tuple[list[bytes], dict[str, int]]:
    counters = Counters()
    inners = opener.open_all(memoryview(datagram), len(datagram), counters)
    return inners, {name: n for name, n in counters.snapshot().items() if n}


@given(st.lists(INNER, min_size=1, max_size=8), CIPHERS)
def test_what_was_sealed_opens_once(inners: list[bytes], cipher: Cipher) -> None:
    """Each datagram opens to what went in; a second time it is a replay."""
    sealer, opener = Sealer(Type.UP, 7, cipher, KEY), Opener(Type.UP, 7, cipher, KEY)
    datagrams = [sealer.seal(inner) for inner in inners]
    assert [open_one(opener, d)[0] for d in datagrams] == [[i] for i in inners]
    assert all(open_one(opener, d) == ([], {"replayed": 1}) for d in datagrams)


def test_every_flipped_bit_is_refused() -> None:
    """No bit of a datagram can be changed, and a refused one does not stop the true one."""
    sealer = Sealer(Type.UP, 7, Cipher.AES_256_GCM, KEY)
    opener = Opener(Type.UP, 7, Cipher.AES_256_GCM, KEY)
    datagram = sealer.seal(b"a message of some length")
    for bit in range(8 * len(datagram)):
        damaged = bytearray(datagram)
        damaged[bit // 8] ^= 1 << bit % 8
        inners, counts = open_one(opener, bytes(damaged))
        assert not inners
        assert set(counts) <= {"not_authentic", "unknown_session"}
    assert open_one(opener, datagram)[0] == [b"a message of some length"]


@given(st.binary(max_size=64), st.integers(1, 64))
def test_any_bytes_are_refused(data: bytes, segment: int) -> None:
    """Noise opens to nothing, whatever its length."""
    opener = Opener(Type.UP, 7, Cipher.AES_256_GCM, KEY)
    assert opener.open_all(memoryview(data), segment, Counters()) == []


@given(st.permutations(range(12)), st.lists(st.integers(0, 11), max_size=12))
def test_a_batch_opens_as_its_datagrams_would(order: list[int], again: list[int]) -> None:
    """Order and repetition within one batch change nothing: each datagram counts once."""
    sealer = Sealer(Type.UP, 7, Cipher.AES_256_GCM, KEY)
    opener = Opener(Type.UP, 7, Cipher.AES_256_GCM, KEY)
    datagrams = [sealer.seal(bytes([i])) for i in range(12)]
    batch = b"".join(datagrams[i] for i in [*order, *again])
    counters = Counters()
    inners = opener.open_all(memoryview(batch), len(datagrams[0]), counters)
    assert [i[0] for i in inners] == order
    assert counters.snapshot()["replayed"] == len(again)
    assert opener.window.count == 12


def test_the_other_direction_is_refused() -> None:
    """A reflected datagram is of the wrong type, even if both keys were the same."""
    down = Sealer(Type.DOWN, 7, Cipher.AES_256_GCM, KEY).seal(b"x")
    assert open_one(Opener(Type.UP, 7, Cipher.AES_256_GCM, KEY), down) == (
        [],
        {"unknown_session": 1},
    )


def test_nonces_never_repeat() -> None:
    """The number goes up by one with every datagram, and at the end nothing more is sealed."""
    sealer = Sealer(Type.UP, 7, Cipher.AES_256_GCM, KEY)
    numbers = [int.from_bytes(sealer.seal(b"x")[9:14], "little") for _ in range(300)]
    assert numbers == list(range(300))
    sealer.number = 2**40 - 2
    assert sealer.used_up


def test_keys_never_show() -> None:
    """The text of a key object holds no key."""
    assert "prefix" not in repr(KEY)


def test_the_cipher_that_both_compute_in_hardware() -> None:
    """AES only if both sides offer it; ChaCha otherwise; a lonely offer is taken."""
    chacha, aes = Cipher.CHACHA20_POLY1305, Cipher.AES_256_GCM
    assert choose_cipher(BOTH, BOTH) is aes
    assert choose_cipher(BOTH, chacha) is chacha
    assert choose_cipher(chacha, BOTH) is chacha
    assert choose_cipher(aes, chacha) is aes
    with pytest.raises(TunnelError, match="no_cipher"):
        choose_cipher(0xF0, BOTH)


@given(st.lists(st.integers(0, 400), max_size=200), st.integers(1, 64))
def test_the_window_is_the_set_of_late_numbers(numbers: list[int], size: int) -> None:
    """Against a set: new is what was not seen and is not older than the window."""
    window, seen = ReplayWindow(size), set[int]()
    for number in numbers:
        new = number not in seen and number > max(seen, default=-1) - size
        assert window.is_new(number) == new
        if new:
            window.mark(number)
            seen.add(number)
    assert window.count == len(seen)
    assert window.newest == max(seen, default=-1)


@given(st.integers(0, 100), st.integers(0, 100))
def test_marking_many_is_marking_one_by_one(before: int, count: int) -> None:
    """``mark_next`` is short for ``mark`` of the numbers that follow."""
    fast, slow = ReplayWindow(64), ReplayWindow(64)
    for number in range(before):
        fast.mark(number)
        slow.mark(number)
    fast.mark_next(count)
    for number in range(before, before + count):
        slow.mark(number)
    assert [fast.is_new(n) for n in range(250)] == [slow.is_new(n) for n in range(250)]
    assert (fast.newest, fast.count) == (slow.newest, slow.count)


def test_first_bytes() -> None:
    """Empty, foreign and unknown datagrams have no type; a RESET says its session."""
    for data, reason in (
        (b"", Refusal.MALFORMED),
        (b"\x26", Refusal.WRONG_VERSION),
        (b"\x1f", Refusal.MALFORMED),
    ):
        with pytest.raises(TunnelError) as error:
            type_of(data)
        assert error.value.reason is reason
    reset = pack_reset(2**64 - 2)
    assert type_of(reset) is Type.RESET
    assert parse_reset(reset) == 2**64 - 2
    with pytest.raises(TunnelError):
        parse_reset(reset + b"x")
