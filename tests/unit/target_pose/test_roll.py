"""The roll from the board's edges, from gravity, or assumed."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import vector_from_rotation
from target_pose.conic import CirclePose
from target_pose.localisation import RollSource
from target_pose.roll import ASSUMED_SIGMA_RAD, find_roll, hinted_roll, rolled_pose
from target_pose.target import load_target
from tests.unit.target_pose.render import Look, facing_pose, render_color

TARGET = load_target()
CAMERA = CameraIntrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)
directions = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(
    lambda v: math.hypot(*v) > 0.1
)


def board_of(pose):
    return CirclePose(pose.translation, pose.rotation[:, 0])


def roll_error(pose, roll):
    turn = rolled_pose(board_of(pose), roll.up).rotation @ pose.rotation.T
    return float(vector_from_rotation(turn) @ pose.rotation[:, 0])


def picture(pose, **look):
    return render_color(TARGET, CAMERA, pose, Look(supersample=3, **look))[..., 0]


@pytest.mark.parametrize("roll_deg", [-30, -8, 0, 13, 33])
@pytest.mark.parametrize("z", [0.9, 2.2])
def test_the_board_s_edges_tell_the_roll(roll_deg, z):
    pose = facing_pose([0.1, 0.05, z], 0.5, 1.0, math.radians(roll_deg))
    roll = find_roll(picture(pose), CAMERA, board_of(pose), TARGET, None)
    assert roll.source is RollSource.EDGES
    assert abs(roll_error(pose, roll)) < math.radians(0.5)
    assert abs(roll_error(pose, roll)) < 3 * roll.sigma_rad


def test_a_wall_lighter_than_the_board_serves_as_well():
    pose = facing_pose([0.0, 0.05, 1.0], 0.3, 1.0, 0.2)
    roll = find_roll(picture(pose, wall=254.0, dim=0.9), CAMERA, board_of(pose), TARGET, None)
    assert roll.source is RollSource.EDGES
    assert abs(roll_error(pose, roll)) < math.radians(0.6)


def test_a_board_cut_by_the_picture_s_border_still_tells():
    pose = facing_pose([0.36, 0.0, 0.8], 0.3, 1.0, 0.15)
    roll = find_roll(picture(pose), CAMERA, board_of(pose), TARGET, None)
    assert roll.source is RollSource.EDGES
    assert abs(roll_error(pose, roll)) < math.radians(0.6)


def test_without_edges_gravity_tells_the_roll():
    """A wall as white as the board."""
    pose = facing_pose([0.1, 0.05, 1.0], 0.4, 1.0, math.radians(50))
    image = picture(pose, wall=215.0)
    roll = find_roll(image, CAMERA, board_of(pose), TARGET, 9.81 * pose.rotation[:, 2])
    assert roll.source is RollSource.GRAVITY
    assert abs(roll_error(pose, roll)) < 1e-6


def test_gravity_tells_which_of_the_four_edges_is_up():
    pose = facing_pose([0.1, 0.05, 1.0], 0.4, 1.0, math.radians(80))
    image = picture(pose)
    told = find_roll(image, CAMERA, board_of(pose), TARGET, pose.rotation[:, 2])
    guessed = find_roll(image, CAMERA, board_of(pose), TARGET, None)
    assert abs(roll_error(pose, told)) < math.radians(0.5)
    assert abs(abs(roll_error(pose, guessed)) - math.pi / 2) < math.radians(0.5)


def test_without_edges_and_gravity_the_roll_is_assumed_and_hardly_known():
    pose = facing_pose([0.1, 0.05, 1.0], 0.4, 1.0, 0.1)
    roll = find_roll(np.full((240, 320), 90, np.uint8), CAMERA, board_of(pose), TARGET, None)
    assert roll.source is RollSource.ASSUMED
    assert roll.sigma_rad == ASSUMED_SIGMA_RAD
    assert abs(roll_error(pose, roll)) < 2 * roll.sigma_rad


def test_noise_has_no_edges():
    pose = facing_pose([0.0, 0.0, 1.0], 0.3, 0.0)
    for seed in range(40):
        noise = np.random.default_rng(seed).integers(0, 256, (240, 320)).astype(np.float32)
        soft = cv2.GaussianBlur(noise, (0, 0), 0.3 + seed / 10)
        soft = np.clip(128 + (soft - 128) * 60 / soft.std(), 0, 255).astype(np.uint8)
        roll = find_roll(soft, CAMERA, board_of(pose), TARGET, None)
        assert roll.source is RollSource.ASSUMED


@settings(deadline=None, max_examples=50)
@given(directions, directions)
def test_up_always_lies_along_the_board_and_the_pose_has_its_normal(normal, gravity):
    n = np.array(normal) / np.linalg.norm(normal)
    board = CirclePose(np.array([0.1, 0.2, 1.5]), n)
    for up in (None, np.array(gravity), n, np.zeros(3)):
        roll = hinted_roll(board, up)
        assert abs(roll.up @ n) < 1e-9
        assert np.linalg.norm(roll.up) == pytest.approx(1)
        rotation = rolled_pose(board, roll.up).rotation
        np.testing.assert_allclose(rotation[:, 0], n, atol=1e-9)
        np.testing.assert_allclose(rotation[:, 2], roll.up, atol=1e-9)


def test_a_board_on_the_floor_takes_no_roll_from_gravity():
    board = CirclePose(np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0]))
    roll = hinted_roll(board, np.array([0.0, -9.81, 0.0]))
    assert roll.source is RollSource.ASSUMED
    assert roll.sigma_rad > ASSUMED_SIGMA_RAD


def test_which_edge_is_up_is_not_claimed_for_a_board_on_the_floor():
    pose = facing_pose([0.0, 0.25, 0.8], math.radians(58), -math.pi / 2, 0.2)
    assert abs(pose.rotation[1, 0]) > 0.95
    roll = find_roll(picture(pose), CAMERA, board_of(pose), TARGET, None)
    assert roll.source is RollSource.EDGES
    assert roll.sigma_rad == math.pi / 4
