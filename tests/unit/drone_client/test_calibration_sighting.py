"""One frame's two opinions, on rendered pictures of a rig with two lenses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from drone_client.calibration.sighting import Miss, Sighting, sight
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from target_pose.candidate import Box, Candidate
from target_pose.target import load_target
from target_pose.window import projected_boxes
from tests.unit.target_pose.render import Look, facing_pose, render_color, render_depth

TARGET = load_target()
LENS = (-0.055, 0.065, 0.0005, -0.0003, -0.02)
COLOR = CameraIntrinsics(320, 240, 300.0, 300.0, 161.0, 119.0, "inverse_brown_conrady", LENS)
DEPTH = CameraIntrinsics(240, 180, 200.0, 200.0, 120.5, 90.0)
STEREO = RgbdCamera(COLOR, DEPTH, 0.001, Pose(np.array([-0.059, 0, 0]), [1.0, 0, 0, 0]))
ALIGNED = RgbdCamera(COLOR, COLOR, 0.001, Pose.identity())
FAR = replace(STEREO, color_from_depth=Pose(np.array([-0.9, 0, 0]), [1.0, 0, 0, 0]))
POSE = facing_pose([0.05, -0.04, 1.1], math.radians(25), 0.8)


def seen(camera=STEREO, pose=POSE, told=None, depth=True, **sensor):
    """What is seen of a rendered frame, with the camera file that it is ``told``."""
    rng = np.random.default_rng(0)
    look = Look(noise=1.0, supersample=3)
    color = render_color(TARGET, camera.color, pose, look, rng)
    units = render_depth(TARGET, camera, pose, look, rng, **({"noise": 5e-4} | sensor))
    boxes = projected_boxes(TARGET, pose, camera.color)
    return sight(
        "f", color, units if depth else None, told or camera, Candidate(boxes, 1.0), TARGET
    )


@pytest.mark.parametrize("camera", [STEREO, ALIGNED])
def test_both_opinions_are_right(camera):
    """The circles in the colour frame, the plane in the depth camera's own."""
    found = seen(camera)
    assert isinstance(found, Sighting)
    np.testing.assert_allclose(found.circles.center, POSE.translation, atol=4e-3)
    assert found.circles.normal @ POSE.rotation[:, 0] > math.cos(math.radians(1.5))
    assert found.ratio == pytest.approx(1, abs=4e-3)
    true = camera.color_from_depth.inverse() @ POSE
    normal = true.rotation[:, 0]
    expected = normal / (normal @ true.translation)
    np.testing.assert_allclose(found.plane.coefficients, expected, atol=0.015)


@pytest.mark.parametrize("ratio", [0.2, 5.0, 10.0, 1000.0])
def test_the_ratio_is_measured_however_wrong_the_unit(ratio):
    """And no plane is fitted to what cannot be metres."""
    unit = 0.001 * min(ratio, 100.0)
    found = seen(STEREO, told=replace(STEREO, depth_scale_m=max(unit, 1e-5)))
    assert isinstance(found, Sighting)
    assert found.ratio == pytest.approx(min(ratio, 100.0), rel=0.01)
    assert found.plane is None


def test_the_camera_file_does_not_touch_the_plane():
    """A wrong place of the depth camera moves the pixels that are taken, not what they say."""
    told = replace(STEREO, color_from_depth=Pose(np.array([-0.049, 0.01, 0.01]), [1.0, 0, 0, 0]))
    right, wrong = seen(), seen(told=told)
    np.testing.assert_allclose(right.plane.coefficients, wrong.plane.coefficients, atol=0.01)


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ({"depth": False}, "no depth picture"),
        ({"holes": 1.0}, "no depth on it"),
        ({"pose": facing_pose([0.05, -0.04, 1.1], math.radians(77), 0.8)}, "circle"),
        ({"told": FAR}, "does not see it whole"),
    ],
)
def test_a_frame_that_says_nothing_says_why(how, reason):
    """Never an exception."""
    found = seen(**how)
    assert isinstance(found, Miss)
    assert reason in found.reason


def test_boxes_of_something_else_are_a_miss():
    """A candidate on a bare wall, and one outside of the picture."""
    grey = np.full((240, 320, 3), 120, np.uint8)
    units = np.full((180, 240), 1500, np.uint16)
    for box in (Box(100, 80, 180, 160, 0.9), Box(5000, 5000, 6000, 6000, 0.9)):
        boxes = dict.fromkeys(TARGET.level_m, box)
        assert isinstance(sight("f", grey, units, STEREO, Candidate(boxes, 0.9), TARGET), Miss)
