"""Depth moved onto the colour camera, against a loop over single pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose, rotation_from_vector
from target_pose.align import align_depth, depth_points_in_box
from target_pose.candidate import Box
from tests.unit.target_pose.render import rays, seen_pixels

COEFFICIENTS = (-0.05, 0.06, 0.0005, -0.0003, -0.02)


def rig(model="inverse_brown_conrady"):
    color = CameraIntrinsics(24, 18, 15.0, 15.4, 11.6, 9.2, model, COEFFICIENTS)
    depth = CameraIntrinsics(28, 20, 16.0, 16.0, 13.2, 10.1, "brown_conrady", COEFFICIENTS)
    turn = rotation_from_vector(np.array([0.01, -0.02, 0.005]))
    return RgbdCamera(color, depth, 0.001, Pose.from_rotation(turn, [0.059, -0.001, 0.002]))


def aligned_rig(size=(24, 18)):
    color = CameraIntrinsics(*size, 15.0 * size[0] / 24, 15.0 * size[0] / 24, 11.0, 9.0)
    return RgbdCamera(color, color, 0.001, Pose.identity())


def naive(depth_units, camera):
    """Colour-frame point and pixel of every depth pixel with a measurement, one at a time."""
    v, u = np.mgrid[: camera.depth.height, : camera.depth.width]
    lines = rays(np.column_stack([u.ravel(), v.ravel()]).astype(float), camera.depth)
    points = []
    for units, ray in zip(depth_units.ravel().tolist(), lines, strict=True):
        z = units * camera.depth_scale_m
        if 0.15 <= z <= 20:
            turned = camera.color_from_depth.rotation @ (ray * z)
            points.append(turned + camera.color_from_depth.translation)
    if not points:
        return []
    return list(zip(points, seen_pixels(np.array(points), camera.color), strict=True))


def random_depth(camera, seed, low=300, high=4000):
    rng = np.random.default_rng(seed)
    shape = (camera.depth.height, camera.depth.width)
    depth = rng.integers(low, high, shape).astype(np.uint16)
    depth[rng.random(shape) < 0.3] = 0
    return depth


@pytest.mark.parametrize("camera", [rig(), rig("brown_conrady"), rig("none"), aligned_rig()])
def test_the_aligned_picture_is_that_of_a_loop_over_pixels(camera):
    depth = random_depth(camera, 0)
    expected = np.zeros((camera.color.height, camera.color.width))
    for point, (u, v) in naive(depth, camera):
        x, y = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
        if 0 <= x < camera.color.width and 0 <= y < camera.color.height:
            old = expected[y, x]
            expected[y, x] = point[2] if old == 0 else min(old, point[2])
    np.testing.assert_allclose(align_depth(depth, camera), expected, atol=1e-6)


def box_sides(box):
    return box.x0, box.y0, box.x1, box.y1


@pytest.mark.parametrize("camera", [rig(), rig("brown_conrady"), rig("none"), aligned_rig()])
@settings(deadline=None, max_examples=20)
@given(st.floats(-8, 26), st.floats(-8, 20), st.floats(0, 24), st.floats(0, 24), st.integers(0, 99))
def test_no_point_of_the_box_is_missed_and_none_is_added(camera, x0, y0, w, h, seed):
    depth = random_depth(camera, seed)
    box = Box(x0, y0, x0 + w, y0 + h, 1.0)
    seen = list(naive(depth, camera))
    # a pixel on a side of the box is in or out by rounding alone
    sides = [
        abs(uv - side) for _, p in seen for uv, side in zip((*p, *p), box_sides(box), strict=True)
    ]
    assume(min(sides, default=1.0) > 1e-9)
    found = depth_points_in_box(depth, camera, box, max_points=100_000)
    inside = [
        point
        for point, (u, v) in seen
        if max(box.x0, -0.5) <= u <= min(box.x1, camera.color.width - 0.5)
        and max(box.y0, -0.5) <= v <= min(box.y1, camera.color.height - 0.5)
    ]
    assert len(found.points) == len(inside)
    if inside:
        order, theirs = np.lexsort(found.points.T), np.lexsort(np.array(inside).T)
        np.testing.assert_allclose(found.points[order], np.array(inside)[theirs], atol=1e-6)


def test_many_points_are_thinned_evenly_to_the_bound():
    camera = aligned_rig((640, 480))
    depth = np.full((480, 640), 1000, dtype=np.uint16)
    found = depth_points_in_box(depth, camera, Box(0, 0, 639, 479, 1.0), max_points=500)
    assert len(found.points) == 500
    counts, _, _ = np.histogram2d(*found.uv_px.T, bins=4)
    assert counts.min() > 20


def test_no_depth_gives_no_points():
    camera = rig()
    empty = np.zeros((20, 28), dtype=np.uint16)
    assert len(depth_points_in_box(empty, camera, Box(0, 0, 50, 40, 1.0)).points) == 0
    assert not align_depth(empty, camera).any()


def test_depth_nearer_than_the_sensor_measures_is_left_out():
    camera = aligned_rig()
    depth = np.full((18, 24), 100, dtype=np.uint16)
    assert len(depth_points_in_box(depth, camera, Box(0, 0, 23, 17, 1.0)).points) == 0
