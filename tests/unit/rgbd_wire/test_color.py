"""Colour: close to what it was, and only ever a whole baseline JPEG of the announced size."""

from __future__ import annotations

import resource
import struct
import tracemalloc

import cv2
import imagecodecs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.color import decode_color, encode_color
from rgbd_wire.errors import DecodeError, Reject
from tests.perf.fuzz_run import resident_bytes

WIDTH, HEIGHT = 64, 48
BASELINE_FRAME = b"\xff\xc0"
SCAN = b"\xff\xda"


def gradient(width=WIDTH, height=HEIGHT):
    v, u = np.mgrid[:height, :width]
    return np.dstack([3 * u, 3 * v, np.full_like(u, 128)]).astype(np.uint8)


@pytest.fixture(scope="module")
def jpeg():
    return encode_color(gradient())


def refusal(data, width=WIDTH, height=HEIGHT):
    with pytest.raises(DecodeError) as caught:
        decode_color(data, width, height)
    assert caught.value.reason is Reject.BAD_COLOR
    return caught.value.detail


def outcome(data):
    """The picture, or the reason why there is none."""
    try:
        return decode_color(data, WIDTH, HEIGHT)
    except DecodeError as error:
        return error.reason


def resized(jpeg, width, height):
    """The same file, claiming another size in its frame header."""
    at = jpeg.index(BASELINE_FRAME)
    return jpeg[: at + 5] + struct.pack(">HH", height, width) + jpeg[at + 9 :]


@given(st.integers(1, 70), st.integers(1, 70))
def test_any_size_round_trips(width, height):
    """From one pixel up, odd sizes too, a smooth picture comes back close to what it was."""
    picture = gradient(width, height)
    decoded = decode_color(encode_color(picture, 95), width, height)
    assert decoded.shape == picture.shape
    assert np.abs(decoded.astype(int) - picture).max() < 16


def test_channels_are_rgb(jpeg):
    """OpenCV, which thinks in BGR, sees the same colours in the file the other way round."""
    bgr = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_allclose(decode_color(jpeg, WIDTH, HEIGHT), bgr[..., ::-1], atol=4)


def test_colour_is_subsampled(jpeg):
    """4:2:0: the frame header gives brightness 2x2 samples where each colour has one."""
    at = jpeg.index(BASELINE_FRAME)
    assert [jpeg[at + 11 + 3 * k] for k in range(3)] == [0x22, 0x11, 0x11]


def test_quality_buys_precision(rng):
    """A higher quality weighs more and errs less."""
    noise = rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    picture = cv2.GaussianBlur(noise, (0, 0), 2)
    files = {q: encode_color(picture, q) for q in (30, 95)}
    errors = {
        q: np.abs(decode_color(f, WIDTH, HEIGHT).astype(int) - picture).mean()
        for q, f in files.items()
    }
    assert len(files[30]) < len(files[95])
    assert errors[30] > errors[95]


def test_pictures_that_are_not_contiguous():
    """A view of a larger picture is coded as the picture that it shows."""
    large = gradient(2 * WIDTH, 2 * HEIGHT)
    assert encode_color(large[::2, ::2]) == encode_color(large[::2, ::2].copy())


def test_cut_off_at_every_length(jpeg):
    """No part of a file passes for the file."""
    for length in range(len(jpeg)):
        refusal(jpeg[:length])


@pytest.mark.parametrize("extra", [b"\0", b"\xff\xd9\0", bytes(100)])
def test_bytes_behind_the_picture(jpeg, extra):
    """Nothing hides behind the end marker."""
    refusal(jpeg + extra)


@pytest.mark.parametrize("size", [(48, 64), (63, 48), (128, 96), (1, 1)])
def test_a_size_that_the_header_did_not_announce(jpeg, size):
    """A picture of another size is refused, not cropped or stretched."""
    refusal(jpeg, *size)


def test_a_small_file_that_claims_a_huge_picture(jpeg):
    """The claim is compared before anything of that size is allocated (20000 x 20000: 1.2 GB)."""
    bomb = resized(jpeg, 20_000, 20_000)
    resident_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    tracemalloc.start()
    detail = refusal(bomb)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "20000x20000" in detail
    assert peak < 1_000_000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident_kib < 64 * 1024


def test_refusing_another_size_keeps_no_memory(jpeg):
    """The codec would not give back what it took by then: 25 kB and more for each such file."""
    wide, deep = (
        resized(jpeg, 4000, HEIGHT),
        jpeg.replace(b"\xff\xc0\0\x11\x08", b"\xff\xc0\0\x11\x0c"),
    )
    assert deep != jpeg
    refusal(wide)
    refusal(deep)
    before = resident_bytes()
    for _ in range(2000):
        outcome(wide)
        outcome(deep)
    assert resident_bytes() - before < 16 * 1024 * 1024


def test_progressive_files_are_refused():
    """Each scan of a progressive file costs a pass over the picture: ten bytes, a millisecond."""
    bgr = gradient()[..., ::-1]
    _, coded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    progressive = coded.tobytes()
    assert imagecodecs.jpeg8_decode(progressive).shape == (HEIGHT, WIDTH, 3)
    assert "baseline" in refusal(progressive)


def test_a_second_scan_costs_nothing(jpeg):
    """Scans behind the first are not decoded: the picture is what it was."""
    at = jpeg.index(SCAN)
    head_bytes = 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
    more = jpeg[:-2] + 50 * jpeg[at : at + head_bytes] + jpeg[-2:]
    decoded = outcome(more)
    assert decoded is Reject.BAD_COLOR or np.array_equal(decoded, outcome(jpeg))


def test_a_first_scan_of_one_component(jpeg):
    """Components in scans of their own are many scans by another name."""
    at = jpeg.index(SCAN)
    one = bytearray(jpeg)
    one[at + 4] = 1
    assert "scan" in refusal(bytes(one))


def test_other_kinds_of_jpeg(jpeg):
    """Grey, four-colour, and arithmetic-coded files are not what the header announced."""
    grey = imagecodecs.jpeg8_encode(np.zeros((HEIGHT, WIDTH), np.uint8))
    ink = imagecodecs.jpeg8_encode(
        np.zeros((HEIGHT, WIDTH, 4), np.uint8), colorspace="CMYK", outcolorspace="CMYK"
    )
    arithmetic = jpeg.replace(BASELINE_FRAME, b"\xff\xc9", 1)
    for data in (grey, ink, arithmetic):
        refusal(bytes(data))


def test_endless_segments():
    """A file of nothing but table segments ends after a bounded look."""
    refusal(b"\xff\xd8" + 100_000 * b"\xff\xe0\x00\x02" + b"\xff\xd9")


@given(st.binary(max_size=100))
def test_garbage(data):
    """Bytes that are no JPEG, bare and between a JPEG's first and last marker."""
    refusal(data)
    refusal(b"\xff\xd8" + data + b"\xff\xd9")


@given(st.data())
def test_damaged_files_decode_or_are_refused(jpeg, data):
    """Whatever bytes change, there is a picture of the right size or a ``BAD_COLOR``."""
    damaged = bytearray(jpeg)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(jpeg) - 1))] = data.draw(st.integers(0, 255))
    decoded = outcome(bytes(damaged))
    assert decoded is Reject.BAD_COLOR or decoded.shape == (HEIGHT, WIDTH, 3)
