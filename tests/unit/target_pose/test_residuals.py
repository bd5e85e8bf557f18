"""Residuals and spreads against the pose's own numbers and against samples."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose, rotation_from_vector
from target_pose.candidate import Box, Candidate
from target_pose.localisation import Localisation, Method, RollSource
from target_pose.localise import localise
from target_pose.residuals import residuals, spread, tilt_rad
from target_pose.target import Level, load_target
from tests.unit.target_pose.render import (
    Look,
    facing_pose,
    render_color,
    render_depth,
    true_box,
)

TARGET = load_target()
PINHOLE = CameraIntrinsics(320, 240, 300.0, 300.0, 161.0, 119.0)
CAMERA = RgbdCamera(PINHOLE, PINHOLE, 0.001, Pose.identity())
POSE = facing_pose([0.1, -0.05, 1.0], math.radians(35), 0.7)


def located(depth_units=None):
    color = render_color(TARGET, PINHOLE, POSE, Look(noise=1.5), np.random.default_rng(1))
    boxes = {
        level: Box(*true_box(TARGET, POSE, PINHOLE, side, level is Level.GOOD), 0.9)
        for level, side in TARGET.level_m.items()
    }
    found = localise(color, depth_units, CAMERA, Candidate(boxes, 0.9), TARGET)
    assert isinstance(found, Localisation)
    return found


def depth(bias=0.0):
    rng = np.random.default_rng(2)
    return render_depth(TARGET, CAMERA, POSE, Look(), rng, noise=1e-3, bias=bias)


def test_circles_are_counted_apart_and_add_up():
    """The points of each circle, the used ones as the localisation counts them."""
    found = located(depth())
    r = residuals(found)
    assert [c.diameter_m for c in r.circles] == [d.diameter_m for d in TARGET.discs]
    assert sum(c.used for c in r.circles) == found.ellipse_points
    assert all(c.used <= c.measured for c in r.circles)
    squares = sum(c.used * c.rms_px**2 for c in r.circles)
    assert math.sqrt(squares / found.ellipse_points) == pytest.approx(found.ellipse_rms_px)


@pytest.mark.parametrize("bias", [0.0, 0.05])
def test_ranges_that_agree_are_few_sigmas_apart_and_others_many(bias):
    """Depth that is 5 % too long stands out, with its sign."""
    r = residuals(located(depth(bias)))
    assert 0 < r.range_ellipse_sigma_m < 0.02
    assert 0 < r.range_plane_sigma_m < 0.02
    if bias:
        assert r.ranges_apart_sigmas > 4
    else:
        assert abs(r.ranges_apart_sigmas) < 3


def test_without_depth_there_is_nothing_to_compare():
    """The circles' residuals stay."""
    r = residuals(located())
    assert (r.range_plane_sigma_m, r.ranges_apart_sigmas) == (None, None)
    assert r.circles


def test_without_circles_there_are_no_residuals():
    """A pose by depth or box alone has none of this."""
    bare = Localisation(POSE, np.eye(6), Method.BOX, RollSource.ASSUMED)
    assert residuals(bare) is None
    assert tilt_rad(bare) == pytest.approx(math.radians(35))


def test_spread_is_that_of_samples():
    """Range, bearing, normal and roll of poses drawn from the covariance."""
    rng = np.random.default_rng(3)
    root = rng.normal(0, 1, (6, 6)) * ([2e-3] * 3 + [3e-3] * 3)
    covariance = root.T @ root
    s = spread(Localisation(POSE, covariance, Method.FUSED, RollSource.EDGES))
    draws = rng.multivariate_normal(np.zeros(6), covariance, 40_000)
    line = POSE.translation / np.linalg.norm(POSE.translation)
    assert np.std(draws[:, :3] @ line) == pytest.approx(s.range_m, rel=0.02)
    across = draws[:, :3] - np.outer(draws[:, :3] @ line, line)
    widest = np.sqrt(np.linalg.eigvalsh(np.cov(across.T))[-1])
    assert widest == pytest.approx(s.across_m, rel=0.02)
    normal = POSE.rotation[:, 0]
    assert np.std(draws[:, 3:] @ normal) == pytest.approx(s.roll_rad, rel=0.02)
    turned = np.stack([rotation_from_vector(d) @ normal for d in draws[:4000, 3:]])
    widest = np.sqrt(np.linalg.eigvalsh(np.cov(turned.T))[-1])
    assert widest == pytest.approx(s.normal_rad, rel=0.05)
