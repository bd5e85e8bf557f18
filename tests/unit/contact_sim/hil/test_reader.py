"""Bytes into words: what PX4 says, in pieces and among garbage, and what nobody should say."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from contact_sim.errors import HilError
from contact_sim.hil.motors import Controls
from contact_sim.hil.reader import BUFFER_MAX, MAX_GARBAGE_BYTES, Interval, Reader, Unknown

NO_BEGIN = bytes(b for b in range(256) if b not in (0xFD, 0xFE))


def packed(*messages, system: int = 1) -> bytes:
    line = mav.MAVLink(None, srcSystem=system, srcComponent=1)
    return b"".join(bytes(message.pack(line)) for message in messages)


def controls(t_us: int = 4000, first: float = 0.5, mode: int = 129, flags: int = 1):
    return mav.MAVLink_hil_actuator_controls_message(t_us, [first, *[0.25] * 15], mode, flags)


def wish(message: float = 115.0, interval_us: float = 5000.0, command: int = 511):
    return mav.MAVLink_command_long_message(0, 0, command, 0, message, interval_us, 0, 0, 0, 0, 0)


def beat():
    return mav.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3)


def test_controls_and_wishes_are_read():
    """In their order; heartbeats and whatever else comes are counted."""
    reader = Reader()
    words = reader.take(packed(beat(), wish(), controls(), wish(command=400), system=7))
    assert words == [
        Interval(115, 5000.0),
        Controls(4000, (0.5, 0.25, 0.25, 0.25), armed=True, lockstep=True),
        Unknown(400),
    ]
    assert reader.counts == {"heartbeats": 1, "commands": 2, "controls": 1}
    assert reader.system == 7
    assert reader.take(packed(mav.MAVLink_timesync_message(0, 1))) == []
    assert reader.counts["others"] == 1


@pytest.mark.parametrize(
    ("mode", "flags", "armed", "lockstep"),
    [(129, 1, True, True), (1, 1, False, True), (128, 0, True, False), (0, 2, False, False)],
)
def test_flags_are_bits(mode, flags, armed, lockstep):
    """Armed in the mode, lockstep in the flags."""
    (word,) = Reader().take(packed(controls(mode=mode, flags=flags)))
    assert (word.armed, word.lockstep) == (armed, lockstep)


@pytest.mark.parametrize("number", [math.nan, math.inf, -1.0, 115.5, 1e30])
def test_a_wish_for_no_message_is_an_unknown_command(number):
    """What is no message's number is wished for in vain."""
    assert Reader().take(packed(wish(message=number))) == [Unknown(511)]


@given(st.lists(st.integers(1, 60), min_size=1))
def test_pieces_make_the_whole(sizes):
    """However TCP cuts it."""
    stream = packed(*[controls(4000 * i) for i in range(1, 20)])
    reader, words, at = Reader(), [], 0
    for size in [*sizes, len(stream)]:
        words += reader.take(stream[at : at + size])
        at += size
    assert [word.t_us for word in words] == [4000 * i for i in range(1, 20)]
    assert reader.counts == {"controls": 19}


@given(st.binary(max_size=300).map(lambda data: bytes(b for b in data if b in NO_BEGIN)))
def test_garbage_between_messages_is_counted(garbage):
    """And the messages around it are read."""
    reader = Reader()
    words = reader.take(packed(controls(1)) + garbage + packed(controls(2)))
    assert [word.t_us for word in words] == [1, 2]
    assert reader.counts["garbage_bytes"] == len(garbage)


@given(st.lists(st.binary(max_size=600), max_size=20))
@example([b"\xfd\xff\xff" + bytes(300)])
@example([b"\xfe\x00", b"\xfd\x00\x01"])
def test_nothing_that_comes_breaks_it(pieces):
    """Any bytes: words, or nothing; never an exception, as long as they are few."""
    reader = Reader()
    for piece in pieces:
        reader.take(piece)


def test_a_message_that_was_changed_on_its_way_is_garbage():
    """By its checksum."""
    data = bytearray(packed(controls()))
    data[20] ^= 1
    reader = Reader()
    assert reader.take(bytes(data)) == []
    assert reader.counts == {"garbage_bytes": len(data)}


def test_garbage_without_end_is_an_end():
    """Whoever sends so much of it is no PX4."""
    reader = Reader()
    for _ in range(MAX_GARBAGE_BYTES // 1024):
        reader.take(bytes(1024))
    with pytest.raises(HilError, match="without one MAVLink message.*is it PX4"):
        reader.take(bytes(1024))


def test_random_garbage_without_end_is_an_end_too():
    """Though by chance it holds what looks like messages that nobody knows."""
    reader, chance = Reader(), random.Random(1)

    def noise() -> None:
        for _ in range(2 * MAX_GARBAGE_BYTES // 1024):
            reader.take(chance.randbytes(1024))

    with pytest.raises(HilError, match="without one MAVLink message"):
        noise()


def test_a_good_message_forgives_the_garbage_before_it():
    """A line that loses bytes now and then is no reason to end a flight."""
    reader = Reader()
    for _ in range(5):
        reader.take(bytes(MAX_GARBAGE_BYTES // 2) + packed(beat()))
    assert reader.counts["heartbeats"] == 5


def test_a_busy_line_fills_no_memory():
    """The parser's buffer is cut even if a message is always left half."""
    reader = Reader()
    stream = packed(*[controls(i) for i in range(2000)])
    for at in range(0, len(stream), 100):
        reader.take(stream[at : at + 100])
        assert len(reader._parser.buf) <= BUFFER_MAX + 400
    assert reader.counts["controls"] == 2000
