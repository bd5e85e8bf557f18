"""A small target fitted pixel by pixel: accuracy, honesty, and what it does not fall for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose.appearance import Board, Look
from target_pose.appearance_fit import AppearanceFit, cut_patch, fit_appearance
from target_pose.circle_edges import printed_circles
from target_pose.plane import InverseDepthPlane
from target_pose.target import load_target
from target_pose.vectors import orthogonal_to
from tests.unit.target_pose import render
from tests.unit.target_pose.render import facing_pose, render_color

TARGET = load_target()
BOARD = Board(TARGET.board_side_m / 2, printed_circles(TARGET), white=True)
CAMERA = CameraIntrinsics(128, 96, 385.0, 385.0, 63.5, 47.5)


def seen(pose, rng, **look):
    settings = {"supersample": 6, "blur_px": 0.7, "noise": 1.5, "gamma": 2.2, "jpeg_quality": 85}
    return render_color(TARGET, CAMERA, pose, render.Look(**(settings | look)), rng)[..., 0]


def off_by(pose, rng, centre_px=1.0, turn_deg=4.0):
    """A start that a rough search might give."""
    z = pose.translation[2]
    axis = rng.normal(size=3) * math.radians(turn_deg) / 2
    turned = Pose(np.zeros(3), np.array([1.0, *(axis / 2)]) / np.linalg.norm([1.0, *(axis / 2)]))
    rotation = turned.rotation @ pose.rotation
    center = pose.translation + rng.normal(size=3) * (centre_px * z / 385.0) * [1, 1, 4]
    return Look(center, rotation[:, 0], rotation[:, 2], blur_px2=1.0)


def fitted(image, start, plane=None) -> AppearanceFit | None:
    patch = cut_patch(image, CAMERA, BOARD, start)
    assert patch is not None
    scaled = replace(start, blur_px2=max(start.blur_px2 / patch.bin_px**2, 0.2))
    return fit_appearance(patch, BOARD, scaled, plane)


def error(fit, pose):
    """Distance [m] of the centre, angle [deg] of the normal."""
    cosine = float(fit.pose.normal @ pose.rotation[:, 0])
    return (
        float(np.linalg.norm(fit.pose.center - pose.translation)),
        math.degrees(math.acos(min(cosine, 1.0))),
    )


@pytest.mark.parametrize(
    ("z", "blur_px"), [(1.5, 0.7), (2.5, 1.6), (4.0, 0.7), (4.0, 1.6), (6.0, 1.6)]
)
def test_a_blurred_small_target_is_placed_to_a_part_of_a_percent(z, blur_px):
    """Where its rings run into one another, under a tone curve and noise that it is not told."""
    rng = np.random.default_rng(int(10 * z + 100 * blur_px))
    pose = facing_pose([0.02 * z, 0.01 * z, z], 0.7, 0.5, 0.1)
    fit = fitted(seen(pose, rng, blur_px=blur_px), off_by(pose, rng))
    assert fit is not None
    off_m, off_deg = error(fit, pose)
    assert off_m < 0.005 * z
    assert off_deg < 1.5


def test_a_smear_is_taken_into_account():
    """Motion over two pixels along the rows, which a round blur cannot explain."""
    rng = np.random.default_rng(5)
    pose = facing_pose([0.0, 0.0, 4.0], 0.8, 1.2)
    fit = fitted(seen(pose, rng, motion_px=2.0), off_by(pose, rng))
    assert fit is not None
    off_m, off_deg = error(fit, pose)
    assert off_m < 0.04
    assert off_deg < 2.5
    assert fit.look.stretch_px2[0] > 0


def test_something_in_front_is_left_out():
    """An arm over a fifth of the board."""
    rng = np.random.default_rng(7)
    pose = facing_pose([0.0, 0.0, 4.0], 0.5, 2.0)
    image = seen(pose, rng).copy()
    image[:, 68:76] = 90
    fit = fitted(image, off_by(pose, rng, centre_px=0.5))
    assert fit is not None
    assert error(fit, pose)[0] < 0.04
    assert fit.inliers.mean() < 0.97


def test_the_information_covers_the_errors_and_not_much_more():
    """Squared Mahalanobis errors of sixty tilts against chi square.

    Wider than chi square by what real pictures err beyond noise, which these have none of.
    """
    rng = np.random.default_rng(11)
    squares = []
    for _ in range(60):
        azimuth, tilt = rng.uniform(0, 2 * math.pi), rng.uniform(0.3, 1.0)
        pose = facing_pose([*rng.uniform(-0.3, 0.3, 2), rng.uniform(3, 6)], tilt, azimuth)
        fit = fitted(seen(pose, rng, jpeg_quality=None, noise=3.0), off_by(pose, rng, 0.5, 2.0))
        assert fit is not None
        across = np.stack(orthogonal_to(fit.pose.normal))
        covariance = np.linalg.pinv(fit.information)
        turn = np.cross(fit.pose.normal, pose.rotation[:, 0])
        of_tilt = across @ covariance[3:, 3:] @ across.T
        squares.append(float(across @ turn @ np.linalg.solve(of_tilt, across @ turn)))
    shares = [float(np.mean(np.array(squares) < chi2.ppf(p, 2))) for p in (0.05, 0.5, 0.95)]
    assert shares[0] < 0.6
    assert shares[1] > 0.5
    assert shares[2] > 0.93


def test_the_depth_s_plane_pulls_as_its_covariance_says():
    """A plane that is sure moves the pose onto it, one that is not leaves it alone."""
    rng = np.random.default_rng(3)
    pose = facing_pose([0.0, 0.0, 4.0], 0.5, 1.0)
    image, start = seen(pose, rng), off_by(pose, rng)
    free = fitted(image, start)
    assert free is not None
    normal = pose.rotation[:, 0]
    exact = normal / float(normal @ pose.translation) * 0.99
    ranges = []
    for sigma in (1e-5, 10.0):
        plane = InverseDepthPlane(exact, np.eye(3) / sigma**2, 1000, sigma)
        fit = fitted(image, start, plane)
        assert fit is not None
        ranges.append(float(np.linalg.norm(fit.pose.center)))
    assert ranges[0] == pytest.approx(4.0 / 0.99, rel=1e-3)
    assert ranges[1] == pytest.approx(float(np.linalg.norm(free.pose.center)), rel=1e-4)


@pytest.mark.parametrize("picture", ["black", "white", "noise"])
def test_a_picture_without_a_board_gives_no_number_that_is_none(picture):
    """Whatever comes out is finite, or None."""
    rng = np.random.default_rng(1)
    pose = facing_pose([0.0, 0.0, 4.0], 0.5, 1.0)
    image = {
        "black": np.zeros((96, 128), np.uint8),
        "white": np.full((96, 128), 255, np.uint8),
        "noise": rng.integers(0, 256, (96, 128)).astype(np.uint8),
    }[picture]
    fit = fitted(image, off_by(pose, rng))
    if fit is not None:
        assert np.isfinite(fit.information).all()
        assert np.isfinite(fit.pose.center).all()
        assert math.isfinite(fit.contrast)


def test_a_board_outside_of_the_picture_has_no_patch():
    pose = facing_pose([5.0, 0.0, 4.0], 0.5, 1.0)
    look = Look(pose.translation, pose.rotation[:, 0], pose.rotation[:, 2])
    assert cut_patch(np.zeros((96, 128), np.uint8), CAMERA, BOARD, look) is None
