"""Pictures from anywhere, and what is drawn over them."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.figures.conditions import CONDITIONS, camera_of
from contact_sim.figures.picture import Studio, camera_at, error_m, project, target_lines
from contact_sim.scene import build_scene
from contact_sim.sensing import d455
from rgbd_wire.geometry import Pose, rotation_from_vector
from target_pose.target import load_round_target

COLOR = d455().color


@given(st.floats(-3.1, 3.1), st.floats(-1.2, 1.2))
def test_a_camera_looks_where_it_is_told_and_is_level(heading, down):
    """Its z is the line of sight, its x lies in the horizon, its y points down."""
    pose = camera_at(np.array([1.0, 2.0, 3.0]), heading, down)
    right, below, ahead = pose.rotation.T
    wanted = [
        math.cos(heading) * math.cos(down),
        math.sin(heading) * math.cos(down),
        -math.sin(down),
    ]
    np.testing.assert_allclose(ahead, wanted, atol=1e-12)
    assert right[2] == pytest.approx(0.0, abs=1e-12)
    assert below[2] < 0.0


def test_pixels_are_opencvs(rng):
    """Of points before the camera; one behind it, and there are none."""
    pose = Pose.from_rotation(rotation_from_vector(0.2 * rng.normal(size=3)), np.array([0, 0, 2.0]))
    points = rng.uniform(-0.5, 0.5, (20, 3))
    vector, _ = cv2.Rodrigues(pose.rotation)
    theirs, _ = cv2.projectPoints(
        points, vector, pose.translation, COLOR.image_from_camera, np.zeros(5)
    )
    np.testing.assert_allclose(project(points, pose, COLOR), theirs[:, 0], atol=1e-9)
    assert project(np.array([[0.0, 0.0, -3.0]]), pose, COLOR) is None


def test_the_lines_are_the_boards():
    """Its edge is its side's, each circle lies on its disc, the axes begin in the centre."""
    target = load_round_target()
    square, *circles = target_lines(target)[: 1 + len(target.discs)]
    assert np.ptp(square.points[:, 1]) == pytest.approx(target.board_side_m)
    for line, disc in zip(circles, target.discs, strict=True):
        radii = np.linalg.norm(line.points, axis=1)
        np.testing.assert_allclose(radii, disc.diameter_m / 2)
    for line in target_lines(target)[-3:]:
        assert not line.points[0].any()


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda c: c.name)
def test_every_condition_has_the_board_in_its_picture(condition):
    """As far away as it says, all of its corners inside."""
    scene = build_scene(condition.world, condition.seed, condition.board)
    camera_from_target = camera_of(condition, scene).inverse() @ scene.world_from_target
    away_m = float(np.linalg.norm(camera_from_target.translation))
    assert away_m == pytest.approx(condition.away_m, abs=0.12)
    pixels = project(target_lines(load_round_target())[0].points, camera_from_target, COLOR)
    assert (pixels >= 0).all()
    assert (pixels <= (COLOR.width - 1, COLOR.height - 1)).all()


def test_the_studio_takes_its_picture_from_there():
    """The camera is where it was put, with the arm in view, and black without light."""
    scene = build_scene("tunnel", 3)
    pose = camera_of(CONDITIONS[0], scene)
    with Studio(scene, 3) as studio:
        lit = studio.take(0, pose)
        frame = studio.frame(lit)
    assert error_m(lit.world_from_camera, pose) < 1e-9
    np.testing.assert_allclose(lit.world_from_camera.rotation, pose.rotation, atol=1e-9)
    assert frame.color_rgb is lit.color_rgb
    arm = lit.color_rgb[-60:, COLOR.width // 2 - 3 : COLOR.width // 2 + 3].mean()
    assert arm < 0.6 * lit.color_rgb.mean()
