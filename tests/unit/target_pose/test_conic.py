"""The two poses of a circle, against its exact projection."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from target_pose.conic import CirclePose, circle_poses, conic_of_circle, other_fold
from target_pose.ellipse import fit_ellipse

angles = st.floats(0, 2 * math.pi)


@st.composite
def circles(draw, max_tilt_deg=80.0):
    """A circle in front of the camera that faces it, and its radius."""
    z = draw(st.floats(0.3, 8))
    center = z * np.array([draw(st.floats(-0.8, 0.8)), draw(st.floats(-0.8, 0.8)), 1.0])
    ray = center / np.linalg.norm(center)
    across = np.cross(ray, [0.3, 0.9, 0.1])
    across /= np.linalg.norm(across)
    azimuth, tilt = draw(angles), math.radians(draw(st.floats(0, max_tilt_deg)))
    sideways = math.cos(azimuth) * across + math.sin(azimuth) * np.cross(ray, across)
    normal = -math.cos(tilt) * ray + math.sin(tilt) * sideways
    radius = draw(st.floats(0.02, 0.2)) * float(np.linalg.norm(center))
    return CirclePose(center, normal), radius


def rim(circle, radius, count=40):
    """Points of the circle itself, projected: what no conic formula was used for."""
    basis = np.linalg.svd(circle.normal[None])[2][1:]
    a = np.linspace(0, 2 * math.pi, count, endpoint=False)
    points = circle.center + radius * (np.stack([np.cos(a), np.sin(a)], axis=1) @ basis)
    return points[:, :2] / points[:, 2:], points


@settings(deadline=None, max_examples=40)
@given(circles())
def test_one_of_the_two_poses_is_the_circle_that_was_projected(case):
    circle, radius = case
    xy, points = rim(circle, radius)
    if points[:, 2].min() < 0.05:
        return
    conic = fit_ellipse(xy)
    assert conic is not None
    poses = circle_poses(conic, radius)
    assert poses is not None
    error = min(
        np.linalg.norm(p.center - circle.center) / np.linalg.norm(circle.center)
        + np.linalg.norm(p.normal - circle.normal) ** 2
        for p in poses
    )
    # a frontal circle's tilt shows in second order only, hence the square
    assert error < 1e-6


@settings(deadline=None, max_examples=40)
@given(circles(max_tilt_deg=75.0))
def test_both_poses_project_to_the_same_outline(case):
    circle, radius = case
    poses = circle_poses(conic_of_circle(circle, radius), radius)
    assert poses is not None
    conic = conic_of_circle(circle, radius)
    for pose in poses:
        xy, points = rim(pose, radius)
        d = np.column_stack([xy, np.ones(len(xy))])
        error = np.einsum("ij,jk,ik->i", d, conic, d)
        assert np.abs(error).max() < 1e-7 * np.abs(conic).max()
        assert pose.center[2] > 0
        assert pose.normal @ pose.center < 0


@settings(deadline=None, max_examples=40)
@given(circles(), st.floats(-1e3, 1e3).filter(lambda s: abs(s) > 1e-3))
def test_scale_and_sign_of_a_conic_do_not_matter(case, scale):
    circle, radius = case
    conic = conic_of_circle(circle, radius)
    one, other = circle_poses(conic, radius), circle_poses(scale * conic, radius)
    assert one is not None
    assert other is not None
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a.center, b.center, rtol=1e-6, atol=1e-9)


@settings(deadline=None, max_examples=40)
@given(circles(max_tilt_deg=75.0))
def test_the_other_fold_of_the_other_fold_is_the_first(case):
    circle, radius = case
    back = other_fold(other_fold(circle, radius), radius)
    np.testing.assert_allclose(back.center, circle.center, rtol=1e-5, atol=1e-7)


def test_a_conic_that_is_no_ellipse_has_no_pose():
    """A hyperbola's cone holds circles, too, but not in front of the camera alone."""
    for conic in (np.eye(3), np.diag([1.0, 0.0, -1.0]), np.zeros((3, 3)), np.full((3, 3), np.nan)):
        assert circle_poses(conic, 0.1) is None
