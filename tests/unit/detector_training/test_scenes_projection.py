"""Boxes, areas and shares of the target's projected shapes, against dense points and grids."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector_training.scenes import projection
from detector_training.scenes.placement import facing
from rgbd_wire.camera import CameraIntrinsics

CAMERA = CameraIntrinsics(640, 480, 600.0, 590.0, 318.0, 241.0)

poses = st.builds(
    lambda x, y, z, tilt, about, roll: facing(np.array([x * z, y * z, z]), tilt, about, roll),
    st.floats(-0.5, 0.5),
    st.floats(-0.4, 0.4),
    st.floats(0.8, 12.0),
    st.floats(0.0, math.radians(70)),
    st.floats(0.0, 2 * math.pi),
    st.floats(-math.pi, math.pi),
)


def seen_by_hand(pose, points_yz):
    """Pixels of board points by moving each in space and dividing by its depth."""
    pixels = []
    for y, z in points_yz:
        p = pose @ np.array([0.0, y, z])
        pixels.append((CAMERA.fx * p[0] / p[2] + CAMERA.cx, CAMERA.fy * p[1] / p[2] + CAMERA.cy))
    return np.array(pixels)


@given(poses, st.floats(0.03, 0.2))
def test_circle_box_bounds_the_projected_circle(pose, radius_m):
    """The closed form agrees with 2000 points of the circle, moved and projected one by one."""
    angle = np.linspace(0, 2 * math.pi, 2000, endpoint=False)
    circle = radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    pixels = seen_by_hand(pose, circle)
    box = projection.circle_box(projection.image_from_board(CAMERA, pose), radius_m)
    # 2000 points miss the extreme by up to size * (pi / 2000)^2 / 2
    expected = (*pixels.min(0), *pixels.max(0))
    assert box == pytest.approx(expected, abs=0.005)


@given(poses)
def test_square_box_bounds_the_four_corners(pose):
    """The box of the board is that of its corners, moved and projected one by one."""
    corners = [(-0.2, -0.2), (-0.2, 0.2), (0.2, -0.2), (0.2, 0.2)]
    pixels = seen_by_hand(pose, corners)
    box = projection.square_box(projection.image_from_board(CAMERA, pose), 0.4)
    assert box == pytest.approx((*pixels.min(0), *pixels.max(0)), abs=1e-6)


@given(poses)
def test_boxes_nest_and_facing_boards_are_in_front(pose):
    """The disc's box lies inside the board's, and the board shows us its face."""
    h = projection.image_from_board(CAMERA, pose)
    outer, inner = projection.square_box(h, 0.4), projection.circle_box(h, 0.15)
    assert outer[0] < inner[0] < inner[2] < outer[2]
    assert outer[1] < inner[1] < inner[3] < outer[3]
    assert projection.is_in_front(pose, 0.4)


def test_a_board_seen_from_behind_is_not_in_front():
    """A board that faces away, or that reaches behind the camera, is refused."""
    away = facing(np.array([0.0, 0.0, 2.0]), math.pi, 0.3, 0.0)
    close = facing(np.array([0.0, 0.0, 0.1]), math.radians(60), 0.0, 0.0)
    assert not projection.is_in_front(away, 0.4)
    assert not projection.is_in_front(close, 0.4)


@given(
    st.floats(-100, 740),
    st.floats(-100, 580),
    st.floats(20, 300),
    st.floats(0, math.pi),
)
def test_share_inside_counts_the_area_in_the_picture(x, y, size, turn):
    """The clipped polygon's share agrees with counting grid points of a turned square."""
    corners = projection.square_corners(size)
    c, s = math.cos(turn), math.sin(turn)
    polygon = corners @ np.array([[c, s], [-s, c]]) + (x, y)
    steps = (np.arange(200) + 0.5) / 200 - 0.5
    grid = np.stack(np.meshgrid(steps * size, steps * size), -1).reshape(-1, 2)
    points = grid @ np.array([[c, s], [-s, c]]) + (x, y)
    inside = (points > -0.5).all(1) & (points[:, 0] < 639.5) & (points[:, 1] < 479.5)
    assert projection.share_inside(polygon, 640, 480) == pytest.approx(inside.mean(), abs=0.015)


def test_share_inside_is_exact_at_the_ends():
    """All inside is one, all outside is nothing, a half is a half."""
    square = projection.square_corners(20)
    assert projection.share_inside(square + 100, 640, 480) == pytest.approx(1.0)
    assert projection.share_inside(square + (-100, 50), 640, 480) == 0.0
    assert projection.share_inside(square + (-0.5, 50), 640, 480) == pytest.approx(0.5)
