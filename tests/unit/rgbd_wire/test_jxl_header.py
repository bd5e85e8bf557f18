"""JPEG XL files that are more than one plain picture are seen before their decoder runs."""

from __future__ import annotations

import contextlib

import imagecodecs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.errors import DecodeError, Reject
from rgbd_wire.jxl_header import check_plain_picture

WIDTH, HEIGHT = 64, 48
IS_LAST_BIT = 80
"""Where the codestream of a 64x48 picture says that its first frame is its last."""
FIRST_BIT = 25
FREE_BITS = {36, *range(49, 54), *range(58, 64), 73, 74}
"""16-bit buffers, which transfer function, which rendering intent, padding, group size."""


def picture(height=HEIGHT, width=WIDTH):
    v, u = np.mgrid[:height, :width]
    return (1000 + 10 * u + v).astype(np.uint16)


def codestream(pixels, **options):
    """The codestream of a picture, out of its container."""
    data = bytes(imagecodecs.jpegxl_encode(pixels, lossless=True, effort=1, **options))
    return data[data.index(b"\xff\x0a") :]


def refusal(data):
    with pytest.raises(DecodeError) as caught:
        check_plain_picture(data)
    assert caught.value.reason is Reject.BAD_DEPTH
    return caught.value.detail


def box(kind, content, length=None):
    size = 8 + len(content) if length is None else length
    return size.to_bytes(4, "big") + kind + content


SIGNATURE = box(b"JXL ", b"\r\n\x87\n")
FILE_TYPE = box(b"ftyp", b"jxl \0\0\0\0jxl ")


@pytest.mark.parametrize("effort", [1, 2, 3, 5, 7])
@pytest.mark.parametrize("flat", [True, False])
def test_what_encoders_write_passes(effort, flat):
    """Every effort of the library's encoder makes a file that is plain enough."""
    pixels = np.full_like(picture(), 7) if flat else picture()
    check_plain_picture(bytes(imagecodecs.jpegxl_encode(pixels, lossless=True, effort=effort)))


@pytest.mark.parametrize(
    "size", [(1, 1), (8, 8), (48, 64), (3, 257), (480, 640), (480, 848), (720, 1280), (2048, 4096)]
)
def test_sizes_of_every_notation_pass(size):
    """Small ones, multiples of eight, known aspect ratios and odd ones are noted differently."""
    check_plain_picture(codestream(np.zeros(size, np.uint16)))


def test_bare_and_boxed_are_the_same():
    """A codestream may stand alone or in a container, its box closed or open-ended."""
    bare = codestream(picture())
    check_plain_picture(bare)
    check_plain_picture(SIGNATURE + FILE_TYPE + box(b"jxlc", bare))
    check_plain_picture(SIGNATURE + FILE_TYPE + box(b"jxlc", bare, length=0))


def test_hidden_layers_are_refused():
    """A layer under the picture decodes, costs time, and shows nowhere; here it is refused."""
    layered = with_hidden_layers(codestream(picture()), 3)
    np.testing.assert_array_equal(imagecodecs.jpegxl_decode(layered), picture())
    assert "is_last" in refusal(layered)


def test_animations_are_refused():
    """Several pictures in one file are not one picture."""
    refusal(codestream(np.stack([picture()] * 3), photometric="gray"))


@pytest.mark.parametrize(
    "container",
    [
        b"",
        SIGNATURE,
        SIGNATURE + FILE_TYPE,
        SIGNATURE + box(b"jxlp", b"\0\0\0\0" + codestream(picture())),
        SIGNATURE + box(b"brob", b"") + box(b"jxlc", codestream(picture())),
        SIGNATURE + box(b"jxlc", codestream(picture())) + box(b"jxlc", codestream(picture())),
        SIGNATURE + box(b"jxlc", b"\x0a\xff"),
        SIGNATURE + box(b"ftyp", b"", length=0) + box(b"jxlc", codestream(picture())),
        SIGNATURE + box(b"ftyp", b"", length=2**32 - 1) + box(b"jxlc", codestream(picture())),
        1000 * FILE_TYPE + box(b"jxlc", codestream(picture())),
    ],
)
def test_other_containers_are_refused(container):
    """Split, compressed, doubled, empty or endless containers: nothing that we write."""
    refusal(container)


@pytest.mark.parametrize("bit", range(FIRST_BIT, IS_LAST_BIT + 1))
def test_a_flipped_header_bit(bit):
    """Of the bits behind the size, all but a few that change no picture must be as they are."""
    damaged = bytearray(codestream(picture()))
    damaged[bit // 8] ^= 1 << bit % 8
    if bit in FREE_BITS:
        check_plain_picture(bytes(damaged))
    else:
        refusal(bytes(damaged))


@given(st.binary(max_size=80))
def test_garbage_is_refused_or_looks_plain(data):
    """Nothing but ``DecodeError`` comes out, however short or strange the file."""
    with contextlib.suppress(DecodeError):
        check_plain_picture(b"\xff\x0a" + data)
    refusal(SIGNATURE + data)


def with_hidden_layers(stream, count):
    """The same file with its only frame put under itself, ``count`` times, not as the last one.

    A frame that is not the last says where it is kept (2 bits) and whether before its colour
    transform (1 bit); its header ends ten bits after ``is_last`` and is filled up to a whole byte.
    """
    start, head_end = 8, IS_LAST_BIT + 11
    bits = int.from_bytes(stream, "little")
    before = bits >> 8 * start & ((1 << IS_LAST_BIT - 8 * start) - 1)
    after = bits >> IS_LAST_BIT + 1 & ((1 << head_end - IS_LAST_BIT - 1) - 1)
    head = before | after << IS_LAST_BIT - 8 * start + 4
    head_bytes = -(-(head_end - 8 * start + 3) // 8)
    layer = head.to_bytes(head_bytes, "little") + stream[-(-head_end // 8) :]
    return stream[:start] + count * layer + stream[start:]
