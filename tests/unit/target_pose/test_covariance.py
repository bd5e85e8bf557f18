"""Covariances: symmetric, positive definite, and as wide as they say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rgbd_wire.geometry import Pose, rotation_from_vector
from target_pose.covariance import (
    MAX_TILT_SIGMA_RAD,
    covariance_along,
    covariance_from_information,
    floored,
    pose_offset,
    widened,
)

NORMAL = np.array([0.0, 0.6, -0.8])
CENTER = np.array([0.3, -0.2, 2.0])


def is_covariance(c):
    return np.array_equal(c, c.T) and np.linalg.eigvalsh(c).min() > 0


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.floats(-6, 12), st.floats(0.01, 1.0))
def test_any_information_even_none_gives_a_covariance(seed, rank, magnitude, roll_sigma):
    basis = np.random.default_rng(seed).normal(size=(6, rank)) * 10 ** (magnitude / 2)
    c = covariance_from_information(basis @ basis.T, NORMAL, CENTER, roll_sigma)
    assert is_covariance(c)


def test_no_information_leaves_the_priors():
    c = covariance_from_information(np.zeros((6, 6)), NORMAL, CENTER, 0.3)
    across = np.array([1.0, 0, 0])
    assert math.sqrt(NORMAL @ c[3:, 3:] @ NORMAL) == pytest.approx(0.3, rel=1e-3)
    assert math.sqrt(across @ c[3:, 3:] @ across) == pytest.approx(MAX_TILT_SIGMA_RAD, rel=1e-3)


def test_full_information_is_inverted():
    sigma = np.array([0.01, 0.02, 0.03, 0.05, 0.06, 0.07])
    c = covariance_from_information(np.diag(sigma**-2.0), NORMAL, CENTER, 100.0)
    np.testing.assert_allclose(np.sqrt(np.diag(c)), sigma, rtol=0.02)


def test_deviations_along_and_across_the_line_of_sight_come_out_there():
    c = covariance_along(
        CENTER, NORMAL, range_sigma_m=0.2, lateral_sigma_m=0.01,
        tilt_sigma_rad=0.4, roll_sigma_rad=0.1,
    )  # fmt: skip
    ray = CENTER / np.linalg.norm(CENTER)
    across = np.cross(ray, [0, 1, 0]) / np.linalg.norm(np.cross(ray, [0, 1, 0]))
    assert math.sqrt(ray @ c[:3, :3] @ ray) == pytest.approx(0.2, rel=1e-3)
    assert math.sqrt(across @ c[:3, :3] @ across) == pytest.approx(0.01, rel=1e-3)
    assert math.sqrt(NORMAL @ c[3:, 3:] @ NORMAL) == pytest.approx(0.1, rel=1e-3)
    assert is_covariance(c)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6), st.floats(0, 1))
def test_a_widened_covariance_reaches_the_offset_and_is_one_still(offset, share):
    base = floored(np.eye(6) * 1e-4)
    d = np.array(offset)
    wide = widened(base, d, share)
    assert np.linalg.eigvalsh(wide).min() > 0
    assert d @ wide @ d == pytest.approx(d @ base @ d + share * (d @ d) ** 2)


def test_the_offset_between_poses_is_the_perturbation_that_the_covariance_speaks_of():
    first = Pose.from_rotation(rotation_from_vector(np.array([0.3, -0.2, 0.5])), CENTER)
    d, r = np.array([0.01, 0.02, -0.03]), np.array([0.1, -0.05, 0.2])
    second = Pose.from_rotation(rotation_from_vector(r) @ first.rotation, first.translation + d)
    np.testing.assert_allclose(pose_offset(first, second), [*d, *r], atol=1e-9)
