"""The direct ellipse fit, against OpenCV's and against the ellipse that the points came from."""

from __future__ import annotations

import math

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from target_pose.ellipse import fit_ellipse


def points(center, axes, angle, count=60, arc=2 * math.pi):
    t = np.linspace(0, arc, count, endpoint=False)
    x, y = axes[0] * np.cos(t), axes[1] * np.sin(t)
    c, s = math.cos(angle), math.sin(angle)
    return np.column_stack([center[0] + c * x - s * y, center[1] + s * x + c * y])


def center_of(conic):
    return np.linalg.solve(conic[:2, :2], -conic[:2, 2])


@settings(deadline=None, max_examples=40)
@given(
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
    st.tuples(st.floats(1, 200), st.floats(1, 200)),
    st.floats(0, math.pi),
    st.floats(1.5, 2 * math.pi),
)
def test_exact_points_give_back_their_ellipse_even_from_an_arc(center, axes, angle, arc):
    xy = points(center, axes, angle, arc=arc)
    conic = fit_ellipse(xy)
    assert conic is not None
    np.testing.assert_allclose(center_of(conic), center, atol=1e-3 * max(axes))
    d = np.column_stack([points(center, axes, angle), np.ones(60)])
    algebraic = np.einsum("ij,jk,ik->i", d, conic, d)
    slope = 2 * np.hypot(*(d @ conic)[:, :2].T)
    assert np.abs(algebraic / slope).max() < 1e-3 * max(axes)


def test_noisy_points_give_what_opencv_gives():
    rng = np.random.default_rng(0)
    xy = points((320, 200), (40, 25), 0.6) + rng.normal(0, 0.3, (60, 2))
    conic = fit_ellipse(xy)
    assert conic is not None
    (u, v), _, _ = cv2.fitEllipseDirect(xy.astype(np.float32).reshape(-1, 1, 2))
    np.testing.assert_allclose(center_of(conic), (u, v), atol=5e-3)


def test_a_point_without_weight_has_no_say():
    xy = points((3, 4), (2, 1), 0.3)
    spoilt = np.vstack([xy, [[50.0, -20.0]]])
    weights = np.ones(61)
    weights[-1] = 0
    conic = fit_ellipse(spoilt, weights)
    assert conic is not None
    np.testing.assert_allclose(center_of(conic), (3, 4), atol=1e-6)


def test_too_few_points_points_on_a_line_and_nan_have_no_ellipse():
    line = np.column_stack([np.arange(20.0), 2 * np.arange(20.0)])
    assert fit_ellipse(line[:5]) is None
    assert fit_ellipse(np.zeros((20, 2))) is None
    assert fit_ellipse(np.full((20, 2), np.nan)) is None
    assert fit_ellipse(line) is None
