"""Ray casting against a plain loop over planes, and the frames of a view."""

from __future__ import annotations

import numpy as np
import pytest

from detector_training.scenes.raycast import Box, cast, pixel_rays, world_points
from detector_training.scenes.room import looking
from rgbd_wire.camera import CameraIntrinsics

CAMERA = CameraIntrinsics(80, 60, 60.0, 62.0, 39.0, 30.5)
ROOM = Box((-3.0, -2.0, 0.0), (2.0, 2.5, 2.8))
BOXES = (
    Box((0.5, -0.5, 0.0), (1.0, 0.4, 1.6)),
    Box((1.2, 0.2, 0.5), (1.9, 1.4, 2.0)),
    Box((-1.0, 0.6, 1.8), (1.5, 0.9, 2.1)),
)


def slow_depth(origin, direction):
    """Depth at which a ray first meets any face, plane by plane, and the box hit."""
    best, which = np.inf, -1
    for index, box in enumerate((ROOM, *BOXES)):
        low, high = np.array(box.low), np.array(box.high)
        for axis in range(3):
            for plane in (low[axis], high[axis]):
                t = (plane - origin[axis]) / direction[axis]
                p = origin + t * direction
                others = [k for k in range(3) if k != axis]
                within = all(low[k] - 1e-9 <= p[k] <= high[k] + 1e-9 for k in others)
                if 0.05 < t < best and within:
                    best, which = t, index
    return best, which


def test_cast_agrees_with_meeting_every_plane_in_turn():
    """Depth, box and place of 300 pixels equal those of a loop over all 24 faces."""
    pose = looking(np.array([-2.0, -0.6, 1.4]), np.array([1.0, 0.25, -0.1]), 0.2)
    rays = pixel_rays(CAMERA)
    hits = cast(rays, pose, ROOM, BOXES)
    points = world_points(rays, pose, hits)
    rng = np.random.default_rng(0)
    boxes_met = set()
    for v, u in zip(rng.integers(0, 60, 300), rng.integers(0, 80, 300), strict=True):
        ray = np.array([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1.0])
        depth, which = slow_depth(pose.translation, pose.rotation @ ray)
        assert hits.depth_m[v, u] == pytest.approx(depth, rel=1e-4)
        assert hits.box[v, u] == which
        boxes_met.add(which)
        box = (ROOM, *BOXES)[which]
        axis, high = divmod(int(hits.face[v, u]), 2)
        assert points[v, u, axis] == pytest.approx((box.high if high else box.low)[axis], abs=1e-4)
    assert boxes_met == {0, 1, 2, 3}


def test_supersampled_rays_average_to_the_pixels_ray():
    """The four finer samples of a pixel surround its centre."""
    fine = pixel_rays(CAMERA, 2).reshape(60, 2, 80, 2, 3).mean((1, 3))
    np.testing.assert_allclose(fine, pixel_rays(CAMERA), atol=1e-6)


def test_looking_has_z_ahead_and_y_down():
    """The optical axis points where asked, x is level, y goes down."""
    pose = looking(np.array([1.0, 2.0, 3.0]), np.array([2.0, 1.0, 0.3]))
    x, y, z = pose.rotation.T
    np.testing.assert_allclose(z, np.array([2.0, 1.0, 0.3]) / np.linalg.norm([2.0, 1.0, 0.3]))
    assert x[2] == pytest.approx(0.0, abs=1e-12)
    assert y[2] < 0
