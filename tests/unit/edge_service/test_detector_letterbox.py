"""Any picture into the net's size, and boxes back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_service.detector.letterbox import (
    PADDING_GRAY,
    WORKING_SIDE_PX,
    check_image,
    letterbox,
    letterbox_into,
)
from edge_service.errors import ImageError


@given(width=st.integers(16, 1400), height=st.integers(16, 1400))
@settings(max_examples=40, deadline=None)
def test_the_input_is_bounded_and_a_multiple_of_the_stride(width, height):
    """Sides are multiples of 32 and at most the working size, whatever comes in."""
    padded, _ = letterbox(np.zeros((height, width, 3), np.uint8))
    assert padded.shape[0] % 32 == padded.shape[1] % 32 == 0
    assert max(padded.shape) <= WORKING_SIDE_PX


@pytest.mark.parametrize(("width", "height"), [(640, 480), (1280, 720), (333, 517), (4096, 16)])
def test_a_box_comes_back_where_it_was(width, height):
    """The outer edges of the picture map to the outer edges of what it was resized to."""
    padded, back = letterbox(np.full((height, width, 3), 200, np.uint8))
    drawn = np.argwhere((padded != 114).all(axis=2))
    y1, x1 = drawn.max(axis=0)
    box = np.array([[-0.5, -0.5, x1 + 0.5, y1 + 0.5]], np.float32)
    want = [[-0.5, -0.5, width - 0.5, height - 0.5]]
    np.testing.assert_allclose(back.to_picture(box), want, rtol=1e-5, atol=1e-3)


def test_a_mark_in_a_shrunk_picture_maps_back_to_its_place():
    """The centre of a bright square is found again to half a pixel of the large picture."""
    picture = np.zeros((720, 1280, 3), np.uint8)
    picture[200:240, 900:960] = 255  # centre (929.5, 219.5)
    padded, back = letterbox(picture)
    v, u = np.argwhere(padded[:360, :640, 0] > 127).mean(axis=0)
    box = back.to_picture(np.array([[u, v, u, v]], np.float32))[0]
    np.testing.assert_allclose(box[:2], [929.5, 219.5], atol=0.5)


@given(
    width=st.integers(16, 1400), height=st.integers(16, 1400), u=st.floats(0, 1), v=st.floats(0, 1)
)
@settings(max_examples=40, deadline=None)
def test_points_come_back_as_the_corners_of_boxes_do(width, height, u, v):
    """Into a net of one size, padded on both sides, and back."""
    _, back = letterbox_into(np.zeros((height, width, 3), np.uint8), (256, 320))
    box = np.array([[320 * u, 256 * v, 300.0, 200.0]], np.float32)
    points = back.points_to_picture(box.reshape(1, 2, 2))
    np.testing.assert_array_equal(points.reshape(1, 4), back.to_picture(box))
    left_top = np.array([[back.left_px - 0.5, back.top_px - 0.5]], np.float32)
    np.testing.assert_allclose(back.points_to_picture(left_top), [[-0.5, -0.5]], atol=1e-4)


def test_a_picture_of_the_working_size_is_not_copied():
    """The common case costs nothing."""
    picture = np.zeros((480, 640, 3), np.uint8)
    assert letterbox(picture)[0] is picture


@pytest.mark.parametrize(
    ("picture", "says"),
    [
        (np.zeros((15, 100, 3), np.uint8), "100x15"),
        (np.zeros((100, 4097, 3), np.uint8), "4097x100"),
        (np.zeros((100, 100), np.uint8), "shape"),
        (np.zeros((100, 100, 4), np.uint8), "shape"),
        (np.zeros((0, 0, 3), np.uint8), "0x0"),
        (np.zeros((100, 100, 3), np.float32), "float32"),
        ([[1, 2, 3]], "list"),
    ],
)
def test_what_is_no_picture_is_refused_in_one_line(picture, says):
    """Size, shape and type are checked, and the message says what came."""
    with pytest.raises(ImageError, match=says) as error:
        check_image(picture)
    assert "\n" not in str(error.value)


@given(height=st.integers(16, 300), width=st.integers(16, 300))
@settings(max_examples=30, deadline=None)
def test_a_net_of_one_size_gets_the_picture_in_its_middle(height, width):
    """Gray on both sides, and the corners come back to the corners."""
    picture = np.full((height, width, 3), 255, np.uint8)
    padded, back = letterbox_into(picture, (96, 160))
    assert padded.shape == (96, 160, 3)
    inside = np.flatnonzero(padded[48, :, 0] == 255)
    rows = np.flatnonzero(padded[:, 80, 0] == 255)
    corners = np.array([[inside[0] - 0.5, rows[0] - 0.5, inside[-1] + 0.5, rows[-1] + 0.5]])
    got = back.to_picture(corners.astype(np.float32))
    np.testing.assert_allclose(got, [[-0.5, -0.5, width - 0.5, height - 0.5]], atol=1e-3)
    assert set(np.unique(padded)) <= {PADDING_GRAY, 255}
    assert abs(inside[0] - (159 - inside[-1])) <= 1
