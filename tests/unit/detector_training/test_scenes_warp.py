"""The drawn target lands where the projection says, to a small part of a pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest

from detector_training.scenes.placement import facing
from detector_training.scenes.printed import Paint, draw_target, radius_grid, wear, with_alpha
from detector_training.scenes.projection import (
    circle_points,
    image_from_board,
    polygon_area,
    project,
    square_corners,
)
from detector_training.scenes.warp import paste, texture_side_px, warp
from rgbd_wire.camera import CameraIntrinsics
from target_pose.target import load_target

CAMERA = CameraIntrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
INK = Paint(np.ones(3, dtype=np.float32), np.zeros(3, dtype=np.float32))


def rendered(pose, target):
    """White board on black: coverage of everything that is printed white, (480, 640)."""
    h = image_from_board(CAMERA, pose)
    side = target.board_side_m
    texture = with_alpha(draw_target(target, texture_side_px(h, side), INK))
    image = np.zeros((480, 640, 3), dtype=np.float32)
    layer = warp(texture, side, h, 640, 480)
    paste(image, layer)
    return image[..., 0].astype(float), h


def centroid(polygon):
    """Centroid of a polygon's area (shoelace)."""
    x, y = polygon.T
    xn, yn = np.roll(x, -1), np.roll(y, -1)
    cross = x * yn - xn * y
    return np.array([((x + xn) * cross).sum(), ((y + yn) * cross).sum()]) / (3 * cross.sum())


@pytest.mark.parametrize(
    ("distance_m", "tilt_deg"), [(0.9, 0), (1.1, 45), (2.5, 20), (5.0, 60), (10.0, 30)]
)
def test_white_area_and_centroid_agree_with_the_projected_shapes(distance_m, tilt_deg):
    """Area and first moments of the picture equal those of board - disc + ring - dot."""
    target = load_target()
    pose = facing(np.array([0.11, -0.07, 1.0]) * distance_m, math.radians(tilt_deg), 0.7, 0.2)
    white, h = rendered(pose, target)
    shapes = [(1, project(h, square_corners(target.board_side_m)))]
    for sign, disc in zip((-1, 1, -1), target.discs, strict=True):
        shapes.append((sign, project(h, circle_points(disc.diameter_m / 2, 2000))))
    area = sum(sign * polygon_area(p) for sign, p in shapes)
    moment = sum(sign * polygon_area(p) * centroid(p) for sign, p in shapes) / area
    assert white.sum() == pytest.approx(area, rel=0.01)
    v, u = np.mgrid[0:480, 0:640]
    seen = np.array([(white * u).sum(), (white * v).sum()]) / white.sum()
    np.testing.assert_allclose(seen, moment, atol=0.03)


def test_print_has_the_diameters_of_the_target_file():
    """Counting ink on the flat print gives the areas of the discs."""
    target = load_target()
    image = draw_target(target, 800, INK)[..., 0].astype(float)
    texel = target.board_side_m / 800
    big, ring, dot = (math.pi * (d.diameter_m / 2) ** 2 for d in target.discs)
    white = target.board_side_m**2 - big + ring - dot
    assert image.sum() * texel**2 == pytest.approx(white, rel=1e-4)


def test_nothing_in_the_picture_is_no_layer():
    """A board outside the picture gives None and no empty array."""
    pose = facing(np.array([5.0, 0.0, 2.0]), 0.0, 0.0, 0.0)
    texture = np.ones((32, 32, 4), dtype=np.float32)
    assert warp(texture, 0.4, image_from_board(CAMERA, pose), 640, 480) is None


def test_wear_changes_the_print_but_not_its_rings():
    """A worn print is still darker on the disc than on the board."""
    target = load_target()
    paint = Paint(np.full(3, 0.8, dtype=np.float32), np.full(3, 0.04, dtype=np.float32))
    clean = draw_target(target, 256, paint)
    worn = clean.copy()
    wear(np.random.default_rng(3), worn, 0.6)
    assert np.abs(worn - clean).mean() > 0.005
    r = radius_grid(256, target.board_side_m)
    assert worn[(r > 0.16)].mean() > 2 * worn[(r > 0.08) & (r < 0.14)].mean()
