"""The size of a picture from its first bytes: what OpenCV decodes is the oracle."""

from __future__ import annotations

import io
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from detector_training.datasets.header import HEAD_BYTES, picture_header, read_header
from detector_training.datasets.sample import decode_image, make_sample
from detector_training.errors import DatasetError

FORMATS = ("JPEG", "PNG", "WEBP", "TIFF")


def picture(kind: str, size=(60, 40), orientation: int | None = None, **options) -> bytes:
    """A picture of Pillow's making."""
    exif = Image.Exif()
    if orientation is not None:
        exif[0x112] = orientation
    file = io.BytesIO()
    Image.new("RGB", size, (200, 30, 30)).save(file, kind, exif=exif, **options)
    return file.getvalue()


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("orientation", [None, *range(1, 9)])
def test_a_turned_picture_has_the_size_that_opencv_shows(kind, orientation):
    """All eight EXIF orientations in every format that has them."""
    data = picture(kind, orientation=orientation)
    header = read_header(data)
    shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert (header.height, header.width) == shown.shape[:2]
    assert header.orientation == (orientation or 1)


@given(
    st.sampled_from([".jpg", ".png", ".webp", ".bmp", ".tiff"]),
    st.integers(1, 300),
    st.integers(1, 300),
    st.sampled_from([(), (3,), (4,)]),
)
def test_every_size_is_read(suffix, width, height, channels):
    """1x1 and up, grey, colour and alpha, as OpenCV writes them."""
    if channels == (4,) and suffix == ".jpg":
        channels = (3,)
    _, data = cv2.imencode(suffix, np.full((height, width, *channels), 90, np.uint8))
    assert read_header(bytes(data))[:2] == (width, height)


def test_lossless_and_plain_webp_and_large_notes_are_read(tmp_path):
    """VP8L, VP8 with its own header, and a size behind a colour profile of 300 kB."""
    assert read_header(picture("WEBP", lossless=True))[:2] == (60, 40)
    path = tmp_path / "profile.jpg"
    path.write_bytes(picture("JPEG", icc_profile=bytes(300_000), orientation=6))
    assert path.stat().st_size > HEAD_BYTES
    assert picture_header(path) == (40, 60, 6)


@given(st.binary(max_size=200), st.sampled_from(FORMATS), st.data())
def test_bytes_that_are_no_picture_never_raise_anything_else(noise, kind, data):
    """Noise behind a real start, and a real picture with a hole."""
    real = picture(kind, orientation=6)
    cut = data.draw(st.integers(0, len(real)))
    for tried in (noise, real[:cut] + noise, real[:cut] + noise + real[cut + len(noise) :]):
        header = read_header(tried)
        sample = make_sample(Path("x.jpg"), (60, 40), ())
        assert header is None or 1 <= header.orientation <= 8
        with suppress(DatasetError):
            decode_image(sample, tried)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_grey_alpha_and_16_bits_become_three_channels_of_eight(depth, channels):
    """The value stays where it was on the scale; alpha is dropped."""
    top = np.iinfo(depth).max
    _, data = cv2.imencode(".png", np.full((5, 7, *channels), top * 0.5, depth))
    rgb = decode_image(make_sample(Path("x.png"), (7, 5), ()), bytes(data))
    assert rgb.shape == (5, 7, 3)
    assert rgb.dtype == np.uint8
    assert abs(int(rgb[0, 0, 0]) - 127) <= 1


@pytest.mark.parametrize(
    ("size", "data", "says"),
    [
        ((60, 40), b"", "is empty"),
        ((60, 40), b"nothing", "cannot be decoded"),
        ((60, 40), picture("JPEG")[:400], "cannot be decoded"),
        ((60, 41), picture("JPEG"), "is 60x40, its label says 60x41"),
        ((60, 40), picture("JPEG", orientation=6), r"is 40x60 \(turned by its EXIF note 6\)"),
        ((9000, 10), picture("PNG", (9000, 10)), "at most 8192 a side"),
    ],
)
def test_a_picture_that_cannot_be_used_is_named(size, data, says):
    """Empty, foreign, cut off, of another size, turned, too large: one line with the file."""
    sample = make_sample(Path("dir/x.jpg"), size, ())
    with pytest.raises(DatasetError, match=rf"dir/x\.jpg.*{says}"):
        decode_image(sample, data)


def test_an_8k_picture_is_read():
    """7680x4320 is within bounds."""
    _, data = cv2.imencode(".jpg", np.full((4320, 7680), 90, np.uint8))
    sample = make_sample(Path("x.jpg"), (7680, 4320), ())
    assert decode_image(sample, bytes(data)).shape == (4320, 7680, 3)


def test_a_small_file_that_unpacks_to_gigabytes_is_never_unpacked(monkeypatch):
    """The header alone refuses it."""
    monkeypatch.setattr(cv2, "imdecode", None)
    head = picture("PNG")
    bomb = head[:16] + (60_000).to_bytes(4) * 2 + head[24:]
    sample = make_sample(Path("x.png"), (60_000, 60_000), ())
    with pytest.raises(DatasetError, match="60000x60000; at most"):
        decode_image(sample, bomb)


def test_a_missing_picture_is_named(tmp_path):
    """With what the system says."""
    with pytest.raises(DatasetError, match=r"a\.jpg: No such file"):
        picture_header(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").touch()
    with pytest.raises(DatasetError, match=r"a\.jpg is empty"):
        picture_header(tmp_path / "a.jpg")
