"""The rig's errors come out of sightings as they were put in, and as surely as is said."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_client.calibration.fit import PRIOR, corrected, fit_rig
from tests.unit.drone_client.rigs import CAMERA, TRUE, sightings, wrong

shift = st.floats(-0.02, 0.02)
turn = st.floats(-0.02, 0.02)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-0.02, 0.02),
    st.tuples(shift, shift, shift),
    st.tuples(turn, turn, turn),
    st.integers(0, 1000),
)
def test_errors_come_out_as_they_were_put_in(scale, shift_m, turn_rad, seed):
    """Without noise, to the second order of the errors and what the prior pulls."""
    camera = wrong(CAMERA, 0.0, shift_m, turn_rad)
    seen = sightings(40, scale, noise=0.0, seed=seed)
    errors = fit_rig(seen, camera.color_from_depth)
    put_in = np.array([scale, *shift_m, *turn_rad])
    np.testing.assert_allclose(errors.estimate[:1], put_in[:1], atol=1.5e-3)
    np.testing.assert_allclose(errors.estimate[1:4], put_in[1:4], atol=2.5e-3)
    np.testing.assert_allclose(errors.estimate[4:], put_in[4:], atol=1.5e-3)
    again = corrected(camera.color_from_depth, errors.estimate)
    assert np.linalg.norm(again.translation - TRUE.translation) < 5e-3


def test_corrected_takes_out_exactly_what_was_put_in():
    """The inverse of putting errors in, for turns of any size."""
    put_in = np.array([0.01, 0.02, -0.01, 0.03, 0.2, -0.1, 0.3])
    camera = wrong(CAMERA, 0.0, put_in[1:4], put_in[4:])
    again = corrected(camera.color_from_depth, put_in)
    np.testing.assert_allclose(again.matrix, TRUE.matrix, atol=1e-12)


def test_said_deviations_are_those_of_repeated_recordings():
    """Over 80 recordings with fresh noise: neither much too sure nor much too modest."""
    camera = wrong(CAMERA, 0.0, (0.01, -0.005, 0.01), (0.005, 0.0, -0.005))
    fits = [fit_rig(sightings(50, 0.01, 1.0, seed), camera.color_from_depth) for seed in range(80)]
    scatter = np.std([f.estimate for f in fits], axis=0)
    said = np.median([f.sigma for f in fits], axis=0)
    assert np.all(said > 0.6 * scatter)
    assert np.all(said < 2.5 * scatter)


def test_outliers_do_not_count():
    """One frame in six whose depth is of something 5 cm before the board."""
    seen = sightings(60, 0.0, 1.0)
    near = sightings(60, -0.05, 1.0)
    mixed = [near[i] if i % 6 == 0 else s for i, s in enumerate(seen)]
    errors = fit_rig(mixed, TRUE)
    assert abs(errors.estimate[0]) < 4e-3
    assert np.abs(errors.estimate[1:4]).max() < 8e-3


def test_what_was_not_seen_keeps_its_prior():
    """From one range alone a factor and a shift forward are not told apart."""
    errors = fit_rig(sightings(40, 0.01, ranges=(1.5, 1.5), tilt_deg=1.0), TRUE)
    assert errors.sigma[0] > 0.01
    assert errors.sigma[3] > 0.4 * PRIOR[3]


def test_frames_that_err_together_do_not_average_out():
    """The same noise ten times over is no surer than once."""
    once = sightings(20, 0.0, 1.0)
    ten = [s for s in once for _ in range(10)]
    sure, copied = fit_rig(once, TRUE).sigma, fit_rig(ten, TRUE).sigma
    assert copied[0] > 0.6 * sure[0]


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_frames_give_a_finite_answer(count):
    """However little was seen."""
    errors = fit_rig(sightings(count), TRUE)
    assert np.isfinite(errors.estimate).all()
    assert (np.linalg.eigvalsh(errors.covariance) > 0).all()
    assert math.isfinite(float(errors.residual_m.sum()))
