"""The window: boxes that a pose puts around the target, against OpenCV's projection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose.candidate import Box
from target_pose.rings import is_board
from target_pose.target import Level, load_target
from target_pose.window import NO_NET, projected_boxes, share_in_picture
from tests.unit.target_pose.render import facing_pose, true_box

TARGET = load_target()
LENS = CameraIntrinsics(640, 480, 385.0, 384.0, 321.0, 239.0)
BENT = CameraIntrinsics(
    640, 480, 385.0, 384.0, 321.0, 239.0, "brown_conrady", (-0.05, 0.06, 0.001, -0.001, -0.02)
)


@pytest.mark.parametrize("lens", [LENS, BENT])
@given(
    st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.6, 6)),
    st.floats(0, 1.2),
    st.floats(-3, 3),
    st.floats(-0.5, 0.5),
)
def test_boxes_are_those_of_the_projected_shapes(lens, center, tilt, azimuth, roll):
    """Squares by their corners, circles by 361 points: OpenCV agrees within one per cent."""
    pose = facing_pose(center, tilt, azimuth, roll)
    boxes = projected_boxes(TARGET, pose, lens)
    assert list(boxes) == list(Level)
    for level, box in boxes.items():
        side, square = TARGET.level_m[level], is_board(level, TARGET)
        expected = np.array(true_box(TARGET, pose, lens, side, square))
        size = max(expected[2:] - expected[:2])
        got = (box.x0, box.y0, box.x1, box.y1)
        np.testing.assert_allclose(got, expected, atol=0.012 * size + 0.01)
        assert box.score == NO_NET


def test_what_is_behind_the_camera_has_no_box():
    """A board behind it has none, one that the camera looks through has only its inner ones."""
    behind = facing_pose((0, 0, 2))
    behind = Pose(-behind.translation, behind.q_wxyz)
    assert projected_boxes(TARGET, behind, LENS) == {}
    beside = facing_pose((0.1, 0, 0.1), tilt_rad=1.4)
    assert Level.GOOD not in projected_boxes(TARGET, beside, LENS)


@given(*[st.floats(-900, 1500)] * 2, *[st.floats(0.5, 900)] * 2)
def test_the_share_in_the_picture_is_that_of_pixels_painted(x0, y0, width, height):
    """A box painted on a much larger canvas, counted inside the picture."""
    box = Box(x0, y0, x0 + width, y0 + height, 0.0)
    inside = [
        max(0.0, min(high, size - 0.5) - max(low, -0.5))
        for low, high, size in ((box.x0, box.x1, 640), (box.y0, box.y1, 480))
    ]
    expected = inside[0] * inside[1] / (width * height)
    assert share_in_picture(box, LENS) == pytest.approx(expected)
    assert 0 <= share_in_picture(box, LENS) <= 1


def test_a_whole_box_is_all_inside_and_an_empty_one_not_at_all():
    """By OpenCV's rectangles."""
    assert share_in_picture(Box(10, 10, 50, 60, 0.0), LENS) == 1
    assert share_in_picture(Box(50, 10, 50, 60, 0.0), LENS) == 0
    half = Box(-20, 100, 20, 140, 0.0)
    area, _ = cv2.rotatedRectangleIntersection(
        ((0, 120), (40, 40), 0), ((319.5, 239.5), (640, 480), 0)
    )
    assert area == cv2.INTERSECT_PARTIAL
    assert share_in_picture(half, LENS) == pytest.approx(20.5 / 40)
