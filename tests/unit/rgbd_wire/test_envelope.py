"""The envelope: whatever goes in comes out, and whatever was changed is refused."""

from __future__ import annotations

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.envelope import MAGIC, MAX_BODY_BYTES, PREFIX_BYTES, VERSION, Kind, seal, unseal
from rgbd_wire.errors import DecodeError, Reject

kinds = st.sampled_from(Kind)


def envelope(
    *, magic=MAGIC, version=VERSION, kind=2, reserved=0, length=None, checksum=None, body=b"body"
):
    """Bytes of an envelope by the table in docs/protocol.md, with any field wrong at will."""
    size = len(body) if length is None else length
    head = struct.pack("<4sBBHI", magic, version, kind, reserved, size)
    crc = zlib.crc32(head + body) if checksum is None else checksum
    return head + struct.pack("<I", crc) + body


def reason_of(data, *accepted):
    with pytest.raises(DecodeError) as caught:
        unseal(data, *(accepted or Kind))
    return caught.value.reason


@given(kinds, st.binary(max_size=256))
def test_round_trip(kind, body):
    """A body comes out as it went in, with its kind."""
    got_kind, got = unseal(seal(kind, body), *Kind)
    assert (got_kind, bytes(got)) == (kind, body)


@given(st.lists(st.binary(max_size=50), max_size=5))
def test_parts_are_joined(parts):
    """Sealing parts is sealing their concatenation."""
    assert seal(Kind.RESULT, *parts) == seal(Kind.RESULT, b"".join(parts))


@given(st.binary(max_size=100))
def test_layout_is_the_documented_one(body):
    """The bytes are those of the table in docs/protocol.md."""
    assert seal(Kind.RESULT, body) == envelope(body=body)


def test_the_body_is_not_copied():
    """The body is a view into the received bytes."""
    data = seal(Kind.FRAME, bytes(100_000))
    _, body = unseal(data, Kind.FRAME)
    assert body.obj is data


def test_truncated_anywhere():
    """A message cut off at any length is refused as truncated."""
    data = seal(Kind.ACK, b"0123456789")
    for length in range(len(data)):
        assert reason_of(data[:length]) is Reject.TRUNCATED


def test_one_flipped_bit_anywhere():
    """Every single flipped bit is found, in the body and in the envelope's own fields."""
    data = seal(Kind.RESULT, b"0123456789")
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        reason_of(bytes(flipped))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", Reject.TRUNCATED),
        (bytes(PREFIX_BYTES), Reject.WRONG_MAGIC),
        (b"GET / HTTP/1.1\r\nHost: worker\r\n\r\n", Reject.WRONG_MAGIC),
        (envelope(magic=b"CREA"), Reject.WRONG_MAGIC),
        (envelope(version=0), Reject.WRONG_VERSION),
        (envelope(version=VERSION + 1), Reject.WRONG_VERSION),
        (envelope(kind=0), Reject.WRONG_KIND),
        (envelope(kind=6), Reject.WRONG_KIND),
        (envelope(kind=255), Reject.WRONG_KIND),
        (envelope(reserved=1), Reject.BAD_HEADER),
        (envelope(reserved=0x8000), Reject.BAD_HEADER),
        (envelope(length=5), Reject.TRUNCATED),
        (envelope(length=3), Reject.WRONG_SIZE),
        (envelope(length=0), Reject.WRONG_SIZE),
        (envelope(length=0xFFFF_FFFF), Reject.OVERSIZED),
        (envelope(checksum=0), Reject.CHECKSUM),
        (envelope() + b"\0", Reject.WRONG_SIZE),
    ],
)
def test_each_wrong_field_has_its_reason(data, reason):
    """Each field is checked, and its reason says which one it was."""
    assert reason_of(data) is reason


@pytest.mark.parametrize("kind", Kind)
def test_a_kind_that_is_not_wanted_here(kind):
    """A receiver takes the kinds that it asked for, and no other."""
    others = [k for k in Kind if k is not kind]
    assert reason_of(seal(kind, b""), *others) is Reject.WRONG_KIND


@pytest.mark.parametrize("kind", Kind)
def test_the_largest_body_passes_and_one_byte_more_does_not(kind):
    """The bound is the documented one, to the byte."""
    limit = MAX_BODY_BYTES[kind]
    unseal(seal(kind, bytes(limit)), kind)
    assert reason_of(seal(kind, bytes(limit + 1)), kind) is Reject.OVERSIZED


@given(st.binary(max_size=64))
def test_garbage_is_refused(data):
    """Bytes that nobody sealed are refused, with a reason."""
    reason_of(data)
