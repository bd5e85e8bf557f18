"""Pictures that somebody hands in: every fault is one sentence that names the field."""

from __future__ import annotations

import json
import struct
import tracemalloc

import cv2
import imagecodecs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_service.errors import InputError
from edge_service.handed_in import frame_of_files
from edge_service.picture_header import PictureHeader, PictureKind, read_header
from tests.unit.edge_service.edge_fakes import CAMERA_JSON, COLOR, DEPTH

JPEG = bytes(imagecodecs.jpeg8_encode(COLOR, level=95))
PNG = bytes(imagecodecs.png_encode(COLOR))
DEPTH_PNG = bytes(imagecodecs.png_encode(DEPTH))
GREY = np.ascontiguousarray(COLOR[..., 0])
RGBA = np.dstack([COLOR, np.full(GREY.shape, 7, np.uint8)])


def png(picture):
    return bytes(imagecodecs.png_encode(np.ascontiguousarray(picture)))


def resized(data, width, height):
    """The PNG with another size in its header, and a right checksum there."""
    ihdr = bytearray(data[12:29])
    ihdr[4:12] = struct.pack(">II", width, height)
    return data[:12] + bytes(ihdr) + struct.pack(">I", imagecodecs.zlib_crc32(ihdr)) + data[33:]


@pytest.mark.parametrize("color", [PNG, png(RGBA)])
def test_a_png_is_taken_as_it_is(color):
    """Lossless colour comes through to the bit, without its alpha; depth always does."""
    frame = frame_of_files(color, DEPTH_PNG, CAMERA_JSON)
    np.testing.assert_array_equal(frame.color_rgb, COLOR)
    np.testing.assert_array_equal(frame.depth_units, DEPTH)
    assert frame.world_from_camera is None


@pytest.mark.parametrize("depth", [None, b""])
def test_a_jpeg_alone_will_do(depth):
    """Depth may be left out."""
    frame = frame_of_files(JPEG, depth, CAMERA_JSON)
    assert np.abs(frame.color_rgb.astype(int) - COLOR).mean() < 2
    assert frame.depth_units is None


@pytest.mark.parametrize("padding", [b"\0", b"\xff", bytes(1024), b"\xff" * 1024])
def test_what_is_written_behind_a_jpeg_is_cut_off(padding):
    """Cameras and phones pad their files; the picture is whole all the same."""
    frame = frame_of_files(JPEG + padding, None, CAMERA_JSON)
    np.testing.assert_array_equal(frame.color_rgb, imagecodecs.jpeg8_decode(JPEG))


PALETTE = PNG[:24] + b"\x08\x03" + PNG[26:]
DAMAGED = PNG[:60] + bytes([PNG[60] ^ 255]) + PNG[61:]


@pytest.mark.parametrize(
    ("color", "depth", "sentence"),
    [
        (b"", None, "color: 0 bytes that are not a JPEG or PNG file"),
        (b"GIF89a", None, "color: 6 bytes that are not a JPEG or PNG file"),
        (PNG[:20], None, "color: 20 bytes that are not a JPEG or PNG file"),
        (png(COLOR[:-1]), None, "color: the picture is 320x239, the camera JSON says 320x240"),
        (resized(PNG, 40000, 40000), None, "color: the picture is 40000x40000, the camera"),
        (png(GREY), None, "color: the PNG is 8-bit grey and must be 8-bit RGB or RGBA"),
        (DEPTH_PNG, None, "color: the PNG is 16-bit grey and must be 8-bit RGB or RGBA"),
        (PALETTE, None, "color: the PNG is a palette picture and must be 8-bit RGB or RGBA"),
        (DAMAGED, None, "color: the PNG cannot be decoded"),
        (PNG[: len(PNG) // 2], None, "color: the PNG cannot be decoded"),
        (JPEG[: len(JPEG) // 2], None, "color: the JPEG is cut off"),
        (JPEG + bytes(1025), None, "color: the JPEG is cut off"),
        (bytes(imagecodecs.jpeg8_encode(GREY)), None, "color: the JPEG has 1 channels"),
        (PNG, JPEG, "depth: the JPEG is 8-bit RGB and must be a 16-bit grey PNG"),
        (PNG, PNG, "depth: the PNG is 8-bit RGB and must be a 16-bit grey PNG"),
        (PNG, png(DEPTH[:, :-2]), "depth: the picture is 318x240, the camera JSON says 320x240"),
        (PNG, b"nothing", "depth: 7 bytes that are not a PNG file"),
        (PNG, DEPTH_PNG[:-40], "depth: the PNG cannot be decoded"),
    ],
)
def test_a_wrong_picture_is_one_sentence(color, depth, sentence):
    """Which field, what it is, what it must be; sizes are given from both sides."""
    with pytest.raises(InputError) as error:
        frame_of_files(color, depth, CAMERA_JSON)
    assert str(error.value).startswith(sentence)
    assert error.value.field == sentence.split(":")[0]


def test_a_wrong_camera_is_one_sentence():
    """The camera's own reader names the field at fault."""
    camera = json.loads(CAMERA_JSON)
    del camera["color"]["fx"]
    with pytest.raises(InputError, match=r"^camera: .*fx"):
        frame_of_files(PNG, None, json.dumps(camera))


def test_a_claim_costs_nothing():
    """A small file that claims a huge picture is refused before anything of that size exists."""
    claim = resized(PNG, 30000, 30000)
    tracemalloc.start()
    with pytest.raises(InputError):
        frame_of_files(claim, None, CAMERA_JSON)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000


@given(st.integers(1, 300), st.integers(1, 300), st.booleans(), st.sampled_from([1, 3]))
def test_headers_agree_with_another_writer(width, height, is_png, channels):
    """Size and channels as OpenCV wrote them, in both kinds of file."""
    picture = np.zeros((height, width, channels), np.uint8)
    _, data = cv2.imencode(".png" if is_png else ".jpg", picture)
    kind = PictureKind.PNG if is_png else PictureKind.JPEG
    assert read_header(data.tobytes()) == PictureHeader(kind, width, height, 8, channels)


def test_a_jpeg_may_pad_its_markers():
    """Fill bytes before a marker are allowed (ITU-T T.81, B.1.1.2) and change nothing."""
    at = JPEG.index(b"\xff\xdb")
    assert read_header(JPEG[:at] + b"\xff\xff" + JPEG[at:]) == read_header(JPEG)


@given(st.sampled_from([JPEG, PNG]), st.integers(0, 700), st.binary(max_size=8), st.data())
def test_no_damage_breaks_the_header_reader(picture, keep, patch, data):
    """Cut and overwritten headers are read or refused, never more than that."""
    at = data.draw(st.integers(0, keep))
    read_header(picture[:at] + patch + picture[at + len(patch) : keep])
