"""The region of interest: nothing of the target is outside it, and it is no larger than it must."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drone_client.region_of_interest import BOARD_RADIUS_M, MARGIN_PX, SPEED_MPS, depth_region
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import SECOND, pose

WIDTH, HEIGHT = 640, 480
LENS = CameraIntrinsics(WIDTH, HEIGHT, 380.0, 382.0, 318.0, 242.0)
CAMERA = RgbdCamera(LENS, LENS, 0.001, pose((0.059, 0.001, 0.0), (0.01, -0.02, 0.005)))
HERE = pose((4.0, -2.0, 1.5), (0.3, -0.9, 0.4))

metres = st.floats(-3, 3)
ages_ns = st.integers(0, 3 * SECOND)
directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 0.1)


def region_of(p_depth, age_ns: int = 0):
    """The region for a target at a point in the depth camera's frame."""
    center = HERE @ CAMERA.color_from_depth @ pose(p_depth)
    return depth_region(center, HERE, age_ns, CAMERA)


@given(st.tuples(metres, metres, st.floats(-1, 6)), ages_ns, directions, st.floats(0, 1))
def test_every_point_that_may_be_the_target_s_is_inside(p_depth, age_ns, direction, share):
    """Wherever on the board, and wherever it moved meanwhile: if it is in the picture, it is in."""
    radius_m = BOARD_RADIUS_M + SPEED_MPS * age_ns / 1e9
    x, y, z = np.add(p_depth, share * radius_m * np.divide(direction, np.linalg.norm(direction)))
    if z < 1e-3:
        return
    u, v = LENS.cx + LENS.fx * x / z, LENS.cy + LENS.fy * y / z
    if not (0 <= u < WIDTH and 0 <= v < HEIGHT):
        return
    x0, y0, x1, y1 = region_of(p_depth, age_ns)
    assert x0 <= u < x1
    assert y0 <= v < y1


@given(st.tuples(metres, metres, st.floats(-1, 6)), ages_ns)
def test_it_is_a_part_of_the_picture_and_never_empty(p_depth, age_ns):
    """As the wire wants it."""
    region = region_of(p_depth, age_ns)
    if region is not None:
        x0, y0, x1, y1 = region
        assert 0 <= x0 < x1 <= WIDTH
        assert 0 <= y0 < y1 <= HEIGHT


@given(st.floats(0.5, 6), ages_ns, ages_ns)
def test_what_is_older_is_larger(z, age_ns, more_ns):
    """Every doubt makes it larger."""
    young, old = region_of((0, 0, z), age_ns), region_of((0, 0, z), age_ns + more_ns)
    assert all(a >= b for a, b in zip(young[:2], old[:2], strict=True))
    assert all(a <= b for a, b in zip(young[2:], old[2:], strict=True))


def test_three_metres_ahead_it_is_the_board_and_a_margin():
    """No larger than the ball's outline."""
    x0, y0, x1, y1 = region_of((0.0, 0.0, 3.0))
    outline_px = 380 * BOARD_RADIUS_M / np.sqrt(3.0**2 - BOARD_RADIUS_M**2)
    assert abs((x1 - x0) - 2 * (outline_px + MARGIN_PX)) <= 3
    assert abs((y1 - y0) - 2 * (outline_px + MARGIN_PX)) <= 3


def test_at_the_wall_it_is_the_whole_picture():
    """The last centimetres before contact leave nothing out."""
    assert region_of((0.0, 0.0, 0.3)) == (0, 0, WIDTH, HEIGHT)


def test_behind_the_drone_or_out_of_sight_there_is_none():
    """Then there is nothing to keep sharp."""
    assert region_of((0.0, 0.0, -1.0)) is None
    assert region_of((20.0, 0.0, 3.0)) is None
    assert depth_region(Pose.identity(), HERE, 0, CAMERA) is None
