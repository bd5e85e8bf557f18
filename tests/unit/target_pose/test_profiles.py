"""Edges along profiles, against steps blurred in closed form."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from scipy.special import erf

from target_pose.profiles import (
    blur_variance,
    gray_values,
    slopes,
    strongest_edges,
)


def step_profiles(at, blur, length=25, low=30.0, high=200.0):
    """Profiles (N, length) of steps blurred by a Gaussian, at positions (N,) in samples."""
    x = np.arange(length) - np.asarray(at)[:, None]
    return low + (high - low) * 0.5 * (1 + erf(x / (blur * math.sqrt(2))))


@settings(deadline=None, max_examples=40)
@given(st.floats(8, 16), st.floats(1.2, 3.0))
def test_a_gaussian_step_is_found_where_it_is(at, blur):
    edges = strongest_edges(slopes(step_profiles([at], blur)))
    assert edges.at[0] == pytest.approx(at, abs=0.02)


@settings(deadline=None, max_examples=40)
@given(st.floats(1.0, 2.5))
def test_the_blur_of_a_step_is_measured(blur):
    profiles = step_profiles(np.linspace(10, 14, 30), blur)
    signed = slopes(profiles)
    variance = blur_variance(signed, strongest_edges(signed))
    assert math.sqrt(variance) == pytest.approx(blur, rel=0.07)


def test_a_step_of_the_wrong_sign_or_at_the_window_s_end_or_none_at_all_has_no_edge():
    falling = step_profiles([12.0], 1.5, low=200, high=30)
    late = step_profiles([24.5], 1.5)
    flat = np.full((1, 25), 90.0)
    outside = step_profiles([12.0], 1.5)
    outside[0, 3] = np.nan
    for profile in (falling, late, flat, outside):
        assert np.isnan(strongest_edges(slopes(profile)).at).all()
    assert math.isnan(blur_variance(slopes(flat), strongest_edges(slopes(flat))))


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_grey_values_are_bilinear_as_scipy_s_and_nan_outside(seed):
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (13, 17)).astype(np.uint8)
    uv = rng.uniform(-3, 20, (200, 2))
    got = gray_values(image, uv)
    expected = map_coordinates(image.astype(float), [uv[:, 1], uv[:, 0]], order=1)
    inside = (uv >= 0).all(axis=1) & (uv[:, 0] <= 16) & (uv[:, 1] <= 12)
    np.testing.assert_allclose(got[inside], expected[inside], atol=1e-9)
    assert np.isnan(got[~inside]).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1)])
def test_a_picture_of_one_row_or_column_has_grey_values_too(shape):
    image = np.arange(shape[0] * shape[1], dtype=np.uint8).reshape(shape)
    height, width = shape
    got = gray_values(image, np.array([[0.0, 0.0], [width - 1.0, height - 1.0], [width, 0.0]]))
    assert got[0] == 0
    assert got[1] == image[-1, -1]
    assert math.isnan(got[2])


def test_a_blurred_disc_s_edge_lies_inside_by_half_variance_times_curvature():
    """What the curvature correction rests on, on a disc blurred by OpenCV at 10 samples a pixel."""
    fine, radius, blur = 10, 8.0, 1.3
    n = 260
    axis = (np.arange(n) + 0.5) / fine - n / fine / 2
    disc = 200.0 * (np.hypot(*np.meshgrid(axis, axis)) > radius)
    row = cv2.GaussianBlur(disc, (0, 0), blur * fine)[n // 2, n // 2 :]
    x = axis[n // 2 :]
    slope = np.gradient(row, x)
    peak = int(slope.argmax())
    a, b, c = np.log(slope[peak - 5 : peak + 6 : 5])
    found = x[peak] + 0.5 * (a - c) / (a - 2 * b + c) * (5 / fine)
    assert found - radius == pytest.approx(-(blur**2) / (2 * radius), rel=0.1)
