"""Probes: 64 bytes, there and back to the bit, and nothing else passes for one."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.envelope import Kind, seal, unseal
from rgbd_wire.errors import DecodeError, Reject
from rgbd_wire.probe import PROBE_BYTES, Probe, decode_probe, seal_probe

counts = st.integers(0, 2**63 - 1)


@given(st.builds(Probe, counts, counts, counts, counts, counts, counts))
def test_round_trip(probe):
    """Every field, and the size that docs/protocol.md says."""
    data = seal_probe(probe)
    assert len(data) == PROBE_BYTES == 64
    _, body = unseal(data, Kind.PROBE)
    assert decode_probe(body) == probe


def test_by_the_table():
    """Six little-endian u64 in the order of the page."""
    body = seal_probe(Probe(1, 2, 3, 4, 5, 6))[16:]
    assert [int.from_bytes(body[i : i + 8], "little") for i in range(0, 48, 8)] == [
        1,
        2,
        3,
        4,
        5,
        6,
    ]


@pytest.mark.parametrize("size", [0, 1, 47])
def test_a_body_of_another_size(size):
    """Shorter than a probe."""
    _, body = unseal(seal(Kind.PROBE, bytes(size)), Kind.PROBE)
    with pytest.raises(DecodeError) as caught:
        decode_probe(body)
    assert caught.value.reason is Reject.WRONG_SIZE


def test_a_longer_one_never_gets_here():
    """The envelope's own bound."""
    with pytest.raises(DecodeError) as caught:
        unseal(seal(Kind.PROBE, bytes(49)), Kind.PROBE)
    assert caught.value.reason is Reject.OVERSIZED


@pytest.mark.parametrize("field", range(6))
def test_numbers_past_63_bits(field):
    """A stamp is a signed 64-bit number of nanoseconds everywhere else."""
    body = bytearray(48)
    body[8 * field + 7] = 0x80
    with pytest.raises(DecodeError) as caught:
        decode_probe(memoryview(body))
    assert caught.value.reason is Reject.BAD_HEADER
