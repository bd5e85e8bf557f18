"""The inverse-depth plane, against least squares and against the plane that the points lie on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from target_pose.plane import SCALE_SIGMA, TILT_SIGMA_RAD, fit_plane, plane_scatter

NOISE = 2.5e-3  # standard deviation of inverse depth [1/m]: sigma_z = 2.5e-3 z^2


def points_on(coefficients, rng, count=900, noise=NOISE, spread=0.08, outliers=0.0):
    xy = rng.uniform(-spread, spread, (count, 2)) + (0.1, -0.05)
    inverse = np.column_stack([xy, np.ones(count)]) @ coefficients
    inverse = inverse + noise * rng.standard_normal(count)
    spoilt = rng.random(count) < outliers
    # what is behind the board, unevenly spread: that a plain fit would follow
    inverse[spoilt & (xy[:, 0] > 0.1)] *= 0.6
    z = 1 / inverse
    return np.column_stack([xy * z[:, None], z])


planes = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.3, 1.5)).map(np.array)


@settings(deadline=None, max_examples=40)
@given(planes, st.integers(0, 2**32 - 1))
def test_exact_points_give_back_their_plane(coefficients, seed):
    points = points_on(coefficients, np.random.default_rng(seed), noise=0.0)
    plane = fit_plane(points)
    assert plane is not None
    np.testing.assert_allclose(plane.coefficients, coefficients, atol=1e-7)
    np.testing.assert_allclose(
        plane.normal, -coefficients / np.linalg.norm(coefficients), atol=1e-6
    )
    assert plane_scatter(plane, points) < 1e-6


def test_clean_noise_gives_what_least_squares_gives():
    """To a fraction of the standard deviation: Tukey's weights differ from one a little."""
    rng = np.random.default_rng(1)
    points = points_on(np.array([0.1, -0.2, 0.5]), rng)
    plane = fit_plane(points)
    assert plane is not None
    design = np.column_stack([points[:, :2] / points[:, 2:], np.ones(len(points))])
    expected = np.linalg.lstsq(design, 1 / points[:, 2], rcond=None)[0]
    sigma = NOISE * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    assert (np.abs(plane.coefficients - expected) < 0.5 * sigma).all()
    assert plane.sigma == pytest.approx(NOISE, rel=0.1)


def test_outliers_are_left_out_as_scipy_s_robust_fit_leaves_them_out():
    rng = np.random.default_rng(2)
    truth = np.array([0.1, -0.2, 0.5])
    points = points_on(truth, rng, outliers=0.6)
    plane = fit_plane(points)
    assert plane is not None
    design = np.column_stack([points[:, :2] / points[:, 2:], np.ones(len(points))])
    inverse = 1 / points[:, 2]
    oracle = least_squares(lambda x: design @ x - inverse, truth, loss="cauchy", f_scale=NOISE).x
    plain = np.linalg.lstsq(design, inverse, rcond=None)[0]
    center = np.array([0.1, -0.05, 1.0])
    assert abs(plane.coefficients @ center - oracle @ center) < 1e-3
    assert abs(plain @ center - oracle @ center) > 2e-2
    assert plane.inliers < 0.8 * len(points)


def test_the_covariance_tells_the_scatter_of_repeated_fits():
    """Over 300 noisy frames; the assumed errors of scale and warp are taken out of it first."""
    rng = np.random.default_rng(3)
    truth = np.array([0.05, 0.1, 0.5])
    center = np.array([0.1, -0.05, 1.0])
    errors, variances = [], []
    for _ in range(300):
        plane = fit_plane(points_on(truth, rng, count=300))
        assert plane is not None
        errors.append((plane.coefficients - truth) @ center)
        systematic = (SCALE_SIGMA * truth @ center) ** 2
        covariance = np.linalg.inv(plane.information)
        variances.append(center @ covariance @ center - systematic)
    assert np.mean(np.square(errors)) == pytest.approx(np.mean(variances), rel=0.5)


def test_correlated_noise_widens_the_covariance():
    """Errors alike in blocks of nine points weigh as a ninth of the points would."""
    rng = np.random.default_rng(4)
    u, v = np.meshgrid(np.linspace(-0.08, 0.08, 36), np.linspace(-0.08, 0.08, 36))
    blocks = np.kron(rng.standard_normal((12, 12)), np.ones((3, 3)))
    alone = rng.standard_normal((36, 36))

    def fit(error):
        z = 1 / (0.5 + 0.02 * error)
        points = np.stack([u * z, v * z, z], axis=-1).reshape(-1, 3)
        plane = fit_plane(points)
        assert plane is not None
        return np.linalg.inv(plane.information)[2, 2] - (SCALE_SIGMA * 0.5) ** 2

    assert fit(blocks) > 4 * fit(alone)


def test_scale_and_warp_bound_what_any_number_of_points_can_tell():
    points = points_on(np.array([0.0, 0.0, 0.5]), np.random.default_rng(5), count=5000, noise=0)
    plane = fit_plane(points)
    assert plane is not None
    covariance = np.linalg.inv(plane.information)
    center = np.array([0.1, -0.05, 1.0])
    assert center @ covariance @ center >= (0.99 * SCALE_SIGMA * 0.5) ** 2
    assert covariance[0, 0] >= (0.98 * TILT_SIGMA_RAD * 0.5) ** 2


def test_too_few_points_or_no_agreement_is_no_plane():
    rng = np.random.default_rng(6)
    assert fit_plane(np.empty((0, 3))) is None
    assert fit_plane(points_on(np.array([0.0, 0.0, 0.5]), rng, count=20)) is None
    assert fit_plane(np.tile([[0.1, 0.2, 1.0]], (100, 1))) is None
    heap = np.column_stack([rng.uniform(-0.1, 0.1, (400, 2)), rng.uniform(0.5, 8.0, 400)])
    plane = fit_plane(heap)
    assert plane is None or plane.sigma > 0.05


def test_a_ray_along_the_plane_never_meets_it():
    points = points_on(np.array([1.0, 0.0, 0.5]), np.random.default_rng(7), noise=0)
    plane = fit_plane(points)
    assert plane is not None
    assert plane.depth_along(np.array([-0.5, 0.0, 1.0])) == np.inf
    assert plane.depth_along(np.array([0.0, 0.0, 1.0])) == pytest.approx(2.0)
