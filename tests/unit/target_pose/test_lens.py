"""Rays and pixels, against OpenCV for one lens model and against each other for both."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics
from target_pose.lens import pixels_from_rays, project, rays_from_pixels

MODELS = ("none", "brown_conrady", "inverse_brown_conrady")
D455 = (-0.055, 0.065, 0.0005, -0.0003, -0.02)


def intrinsics(model, coefficients=D455):
    return CameraIntrinsics(640, 480, 390.0, 392.0, 321.0, 238.0, model, coefficients)


@pytest.mark.parametrize("model", MODELS)
@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(st.floats(0, 639), st.floats(0, 479)), min_size=1, max_size=20))
def test_a_pixel_s_ray_projects_back_to_the_pixel(model, pixels):
    uv = np.array(pixels)
    camera = intrinsics(model)
    back = pixels_from_rays(rays_from_pixels(uv, camera), camera)
    np.testing.assert_allclose(back, uv, atol=1e-5)


@settings(deadline=None, max_examples=40)
@given(st.tuples(*[st.floats(-0.05, 0.05)] * 5), st.integers(0, 2**32 - 1))
def test_brown_conrady_projects_as_opencv_does(coefficients, seed):
    camera = intrinsics("brown_conrady", coefficients)
    xy = np.random.default_rng(seed).uniform(-0.7, 0.7, (30, 2))
    points = np.column_stack([xy * 2.0, np.full(30, 2.0)])
    k = np.array(coefficients)
    uv, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.image_from_camera, k)
    np.testing.assert_allclose(project(points, camera), uv[:, 0], atol=1e-6)


def test_the_inverse_model_is_the_other_one_backwards():
    """What one maps from ideal to seen, the other maps from seen to ideal."""
    xy = np.random.default_rng(1).uniform(-0.6, 0.6, (50, 2))
    forward, backward = intrinsics("brown_conrady"), intrinsics("inverse_brown_conrady")
    seen = pixels_from_rays(xy, forward)
    ideal = rays_from_pixels(xy * (390, 392) + (321, 238), backward)
    np.testing.assert_allclose(seen, ideal * (390, 392) + (321, 238), atol=1e-9)


@settings(deadline=None, max_examples=40)
@given(st.tuples(*[st.floats(-100, 100)] * 5), st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_a_lens_without_inverse_says_nan_and_never_a_wrong_ray(coefficients, u, v):
    camera = intrinsics("brown_conrady", coefficients)
    uv = np.array([[u, v]])
    xy = rays_from_pixels(uv, camera)
    if np.isfinite(xy).all():
        np.testing.assert_allclose(pixels_from_rays(xy, camera), uv, atol=1e-3)


def test_past_the_polynomial_s_turning_point_there_is_no_ray():
    """That of r (1 - r^2 / 2) is 0.544 at r = 0.816: what is seen farther out came from nowhere."""
    camera = intrinsics("brown_conrady", (-0.5, 0.0, 0.0, 0.0, 0.0))
    for angle in np.linspace(0, 6, 13):
        across = np.array([np.cos(angle), np.sin(angle)]) * (390, 392)
        near = rays_from_pixels(np.array([0.54 * across + (321, 238)]), camera)
        assert 0.7 < np.linalg.norm(near) < 0.817
        for radius in np.linspace(0.56, 5.0, 60):
            far = rays_from_pixels(np.array([radius * across + (321, 238)]), camera)
            assert np.isnan(far).all()


def test_a_point_behind_the_camera_has_no_pixel():
    uv = project(np.array([[0.1, 0.2, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), intrinsics("none"))
    assert np.isnan(uv[:2]).all()
    np.testing.assert_allclose(uv[2], (321, 238))
