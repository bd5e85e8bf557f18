"""The rough outline, from poor guesses and among clutter."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from rgbd_wire.camera import CameraIntrinsics
from target_pose.disc_finder import DiscGuess, find_disc
from target_pose.target import load_target
from tests.unit.target_pose.render import Look, facing_pose, render_color, true_box

TARGET = load_target()
CAMERA = CameraIntrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)


def scene(pose, **look):
    rng = np.random.default_rng(0)
    image = render_color(TARGET, CAMERA, pose, Look(supersample=3, **look), rng)[..., 0]
    x0, y0, x1, y1 = true_box(TARGET, pose, CAMERA, 0.3, square=False)
    return image, DiscGuess(((x0 + x1) / 2, (y0 + y1) / 2), ((x1 - x0) / 2, (y1 - y0) / 2))


def farthest_from_disc(pose, uv):
    """Largest distance [px] of points (N, 2) from the true outline."""
    a = np.linspace(0, 2 * math.pi, 2000)
    rim = pose @ (0.15 * np.stack([0 * a, np.cos(a), np.sin(a)], axis=1))
    outline = rim[:, :2] / rim[:, 2:] * 300 + (160, 120)
    return np.linalg.norm(uv[:, None] - outline, axis=2).min(axis=1).max()


@pytest.mark.parametrize(
    ("du", "dv", "grow"), [(0, 0, 1), (0.3, -0.3, 1), (0, 0.2, 0.75), (-0.2, 0, 1.25)]
)
@pytest.mark.parametrize(("tilt_deg", "azimuth"), [(5, 0.0), (40, 0.8), (62, 0.78)])
def test_the_outline_is_found_from_a_poor_guess(du, dv, grow, tilt_deg, azimuth):
    pose = facing_pose([0.1, 0.05, 1.8], math.radians(tilt_deg), azimuth)
    image, guess = scene(pose, noise=2.0)
    (u, v), (a, b) = guess
    poor = DiscGuess((u + du * a, v + dv * b), (a * grow, b * grow))
    outline = find_disc(image, poor, dark_inside=True)
    assert outline is not None
    assert len(outline.uv_px) > 50
    assert farthest_from_disc(pose, outline.uv_px) < 1.0


def test_a_bar_across_the_disc_is_left_out():
    pose = facing_pose([0.0, 0.0, 1.2], 0.4, 1.0)
    image, guess = scene(pose)
    image = np.ascontiguousarray(image)
    u, v = (int(c) for c in guess.center_px)
    cv2.line(image, (u - 90, v + 12), (u + 90, v + 30), 160, 12)
    outline = find_disc(image, guess, dark_inside=True)
    assert outline is not None
    assert farthest_from_disc(pose, outline.uv_px) < 2.5


def test_a_disc_cut_by_the_border_is_found_by_the_part_that_is_seen():
    pose = facing_pose([0.62, 0.0, 1.3], 0.2, 1.0)
    image, guess = scene(pose)
    outline = find_disc(image, guess, dark_inside=True)
    assert outline is not None
    assert farthest_from_disc(pose, outline.uv_px) < 1.0


def test_the_blur_is_told():
    pose = facing_pose([0.0, 0.0, 2.0], 0.2, 1.0)
    outline = find_disc(*scene(pose, blur_px=1.4), dark_inside=True)
    assert outline is not None
    assert outline.blur_px == pytest.approx(1.5, rel=0.15)


def test_inverted_print_plain_walls_and_noise_have_no_disc():
    pose = facing_pose([0.0, 0.0, 1.5], 0.2, 1.0)
    image, guess = scene(pose)
    assert find_disc(255 - image, guess, dark_inside=True) is None
    assert find_disc(np.full_like(image, 80), guess, dark_inside=True) is None
    for seed in range(10):
        noise = np.random.default_rng(seed).integers(0, 256, image.shape).astype(np.uint8)
        assert find_disc(noise, guess, dark_inside=True) is None
