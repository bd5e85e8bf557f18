"""The look at a header alone: right for what is whole, harmless for what is not."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_service.first_look import look
from rgbd_wire.envelope import Kind, seal
from rgbd_wire.errors import DecodeError, Reject
from rgbd_wire.frame_codec import unpack
from tests.unit.edge_service.edge_fakes import message

GOOD = message(drone="d9", sequence=3)


def test_it_reads_the_header_that_is_there():
    """The same as by way of all checks, also where the rest is missing."""
    header = unpack(GOOD).header
    assert look(GOOD) == header
    assert look(memoryview(GOOD)[:1000]) == header


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", Reject.TRUNCATED),
        (GOOD[:19], Reject.TRUNCATED),
        (GOOD[:40], Reject.BAD_HEADER),
        (seal(Kind.FRAME, b"\xff\xff\0\0", bytes(65535)), Reject.OVERSIZED),
    ],
)
def test_what_has_no_header_has_a_reason(data, reason):
    """The same reasons as by way of all checks."""
    with pytest.raises(DecodeError) as error:
        look(data)
    assert error.value.reason is reason


@given(st.binary(max_size=400), st.integers(0, 400))
def test_no_bytes_raise_anything_else(junk, keep):
    """Junk, and a good beginning that goes on with junk."""
    for data in (junk, GOOD[:keep] + junk):
        with suppress(DecodeError):
            look(data)
