"""Covariances in plain floats: the same numbers as a matrix filter in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from contact_sim.vehicle.covariance import AngleCovariance, AxisCovariance

DT_S = 0.004
RUNS = 500


def corrected(p: np.ndarray, variance: float) -> tuple[np.ndarray, np.ndarray]:
    """Gains and covariance after the first state was measured: the textbook's matrices."""
    h = np.eye(len(p))[:1]
    gain = (p @ h.T / (h @ p @ h.T + variance))[:, 0]
    return gain, (np.eye(len(p)) - np.outer(gain, h)) @ p


def test_place_velocity_and_bias_are_those_of_a_matrix_filter():
    """Carried on at 250 Hz and corrected at 50 Hz, gains and covariance agree to nine digits."""
    axis = AxisCovariance(0.01, 0.02, 0.05)
    p = np.diag([0.01, 0.02, 0.05]) ** 2
    f = np.array([[1.0, DT_S, 0.0], [0.0, 1.0, -DT_S], [0.0, 0.0, 1.0]])
    for k in range(RUNS):
        axis.propagate(DT_S, 1e-3, 1e-7)
        p = f @ p @ f.T + np.diag([0.0, 1e-3 * DT_S, 1e-7 * DT_S])
        if k % 5 == 0:
            gain, p = corrected(p, 9e-4)
            assert axis.correct(9e-4) == pytest.approx(tuple(gain), rel=1e-9)
        kept = [axis.pp, axis.pv, axis.pb, axis.vv, axis.vb, axis.bb]
        assert kept == pytest.approx(p[np.triu_indices(3)].tolist(), rel=1e-8)


def test_angle_and_gyro_bias_are_those_of_a_matrix_filter():
    """The same for the angle."""
    angle = AngleCovariance(0.01, 0.002)
    p = np.diag([0.01, 0.002]) ** 2
    f = np.array([[1.0, -DT_S], [0.0, 1.0]])
    for k in range(RUNS):
        angle.propagate(DT_S, 2e-6, 8e-9)
        p = f @ p @ f.T + np.diag([2e-6 * DT_S, 8e-9 * DT_S])
        if k % 5 == 0:
            gain, p = corrected(p, 2.5e-3)
            assert angle.correct(2.5e-3) == pytest.approx(tuple(gain), rel=1e-9)
        kept = [angle.aa, angle.ag, angle.gg]
        assert kept == pytest.approx(p[np.triu_indices(2)].tolist(), rel=1e-8)


def test_a_place_that_is_known_anew_says_nothing_of_the_old_one():
    """What velocity and bias had to do with the old place is forgotten, they themselves are not."""
    axis = AxisCovariance(0.5, 0.02, 0.05)
    for _ in range(100):
        axis.propagate(DT_S, 1e-3, 1e-7)
    velocity, bias = axis.vv, axis.bb
    axis.place_known(9e-4)
    assert (axis.pp, axis.pv, axis.pb) == (9e-4, 0.0, 0.0)
    assert (axis.vv, axis.bb) == (velocity, bias)
    assert axis.correct(9e-4) == pytest.approx((0.5, 0.0, 0.0))
