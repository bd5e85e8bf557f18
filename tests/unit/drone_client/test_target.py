"""The target in the world: composed right, fused right, and outliers kept out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from drone_client.target import (
    GATE_CHI2,
    MAX_VARIANCE,
    OUTLIERS_BEFORE_RESET,
    USUAL_BUDGET,
    OdometryBudget,
    TargetEstimate,
    TargetMeasurement,
    Update,
    measure,
    update,
)
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import MS, SECOND, pose, poses, rotation_of

FLOOR = np.diag([USUAL_BUDGET.sigma_m**2] * 3 + [USUAL_BUDGET.sigma_rad**2] * 3)
TIGHT = np.diag([1e-4] * 3 + [4e-4] * 3)


def random_covariance(rng: np.random.Generator, scale: float = 1e-2) -> np.ndarray:
    """A full covariance, translation and rotation correlated, above the floor."""
    a = rng.normal(size=(6, 6)) * scale
    return a @ a.T + FLOOR


def estimate_at(p: Pose, covariance=TIGHT, t_ns: int = 0) -> TargetEstimate:
    return TargetEstimate(p, covariance, t_ns, 2.0)


def seen_at(p: Pose, covariance=TIGHT, t_ns: int = 0) -> TargetMeasurement:
    return TargetMeasurement(p, covariance, t_ns, 2.0)


def moved(p: Pose, step: np.ndarray) -> Pose:
    """A pose perturbed from the left, by SciPy: translation and rotation vector apart."""
    turned = Rotation.from_rotvec(step[3:]) * rotation_of(p)
    return Pose(p.translation + step[:3], turned.as_quat()[[3, 0, 1, 2]])


def perturbation(from_pose: Pose, to_pose: Pose) -> np.ndarray:
    """The inverse of ``moved``."""
    turn = rotation_of(to_pose) * rotation_of(from_pose).inv()
    return np.concatenate([to_pose.translation - from_pose.translation, turn.as_rotvec()])


seeds = st.integers(0, 2**32 - 1)


@given(poses, seeds, st.integers(0, 3 * SECOND))
def test_fuses_as_the_information_form_does(at, seed, dt_ns):
    """Informations add up: an independent form of the Kalman step, with odometry's drift before."""
    rng = np.random.default_rng(seed)
    before, seen = random_covariance(rng), random_covariance(rng)
    prior = (
        before
        + np.diag(np.repeat([USUAL_BUDGET.drift_mps, USUAL_BUDGET.drift_radps], 3) * dt_ns / SECOND)
        ** 2
    )
    innovation = np.linalg.cholesky(prior + seen) @ rng.normal(size=6) * 0.5
    done, verdict = update(
        estimate_at(at, before), seen_at(moved(at, innovation), seen, t_ns=dt_ns)
    )
    assert verdict is Update.FUSED

    information = np.linalg.inv(prior) + np.linalg.inv(seen)
    posterior = np.linalg.inv(information)
    step = posterior @ np.linalg.inv(seen) @ innovation
    np.testing.assert_allclose(done.covariance, posterior, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(perturbation(at, done.world_from_target), step, rtol=1e-6, atol=1e-9)
    assert done.t_capture_ns == dt_ns


def test_many_measurements_of_one_place_converge_to_it():
    """The mean of 200 noisy sightings is a tenth of the noise of one, and says so."""
    rng = np.random.default_rng(1)
    truth = pose((3, -1, 2), (0.2, 0.1, 2.5))
    estimate = None
    for _ in range(200):
        noise = rng.normal(size=6) * np.sqrt(np.diag(TIGHT))
        estimate, verdict = update(estimate, seen_at(moved(truth, noise)))
        assert verdict in (Update.FIRST, Update.FUSED)
    error = perturbation(truth, estimate.world_from_target)
    expected = np.sqrt(np.diag(TIGHT) / 200)
    assert np.all(np.abs(error) < 4 * expected)
    np.testing.assert_allclose(np.sqrt(np.diag(estimate.covariance)), expected, rtol=1e-6)


def test_the_gate_is_the_99_99_percent_quantile_of_six_dimensions():
    """SciPy's chi-square agrees with the constant."""
    assert pytest.approx(chi2.ppf(0.9999, 6), abs=0.01) == GATE_CHI2


@pytest.mark.parametrize("axis", range(6))
def test_the_gate_closes_exactly_at_its_distance(axis):
    """A sighting just inside is fused, one just outside is not, along each axis."""
    sigma = np.sqrt(2 * TIGHT[axis, axis])
    for share, verdict in ((0.999, Update.FUSED), (1.001, Update.OUTLIER)):
        step = np.zeros(6)
        step[axis] = share * np.sqrt(GATE_CHI2) * sigma
        _, got = update(estimate_at(pose()), seen_at(moved(pose(), step)))
        assert got is verdict


def test_an_outlier_changes_nothing_and_does_not_refresh_the_age():
    """Pose, covariance and time of capture stay; only the count goes up."""
    at = estimate_at(pose((1, 2, 3)), t_ns=100 * MS)
    done, verdict = update(at, seen_at(pose((1, 2, 4)), t_ns=200 * MS))
    assert verdict is Update.OUTLIER
    assert done.world_from_target is at.world_from_target
    assert done.covariance is at.covariance
    assert done.t_capture_ns == 100 * MS
    assert done.outliers == 1


def test_starts_again_after_four_that_disagree_in_a_row():
    """Then it is the estimate that is wrong, and the newest sighting takes its place."""
    assert OUTLIERS_BEFORE_RESET == 4
    estimate, verdicts = estimate_at(pose()), []
    for i in range(4):
        estimate, verdict = update(estimate, seen_at(pose((5, i, 0)), t_ns=i * MS))
        verdicts.append(verdict)
    assert verdicts == [Update.OUTLIER] * 3 + [Update.RESET]
    np.testing.assert_array_equal(estimate.world_from_target.translation, (5, 3, 0))
    np.testing.assert_array_equal(estimate.covariance, TIGHT)
    assert estimate.t_capture_ns == 3 * MS
    assert estimate.outliers == 0


def test_one_that_agrees_in_between_starts_the_count_again():
    """Only outliers in a row mean that the estimate is wrong."""
    estimate = estimate_at(pose())
    for i in range(20):
        where = pose() if i % 4 == 3 else pose((5, 0, 0))
        estimate, verdict = update(estimate, seen_at(where, t_ns=i))
        assert verdict is (Update.FUSED if i % 4 == 3 else Update.OUTLIER)


def test_an_outlier_in_rotation_alone_is_one():
    """The right place with a board that faces elsewhere is not the same target."""
    _, verdict = update(estimate_at(pose()), seen_at(pose((0, 0, 0), (0, 0, 0.5))))
    assert verdict is Update.OUTLIER


@given(
    poses,
    st.lists(
        st.tuples(seeds, st.floats(-3, 1.4), st.integers(0, SECOND), st.booleans()), max_size=8
    ),
)
def test_covariance_stays_symmetric_and_positive(at, events):
    """Whatever comes in, from millimetres to the largest variance that is let in."""
    estimate = None
    t_ns = 0
    for seed, magnitude, dt_ns, elsewhere in events:
        rng = np.random.default_rng(seed)
        covariance = random_covariance(rng, 10**magnitude)
        covariance *= min(1.0, MAX_VARIANCE / np.trace(covariance))
        t_ns += dt_ns
        where = moved(at, rng.normal(size=6) * (1.0 if elsewhere else 1e-3))
        measurement = measure(pose(), where, covariance, t_ns)
        if np.trace(measurement.covariance) > MAX_VARIANCE:
            continue
        estimate, _ = update(estimate, measurement)
        c = estimate.covariance
        np.testing.assert_allclose(c, c.T, rtol=0, atol=1e-9 * np.trace(c))
        assert np.linalg.eigvalsh(0.5 * (c + c.T))[0] > 0
        assert np.isfinite(estimate.sigma_m)


def test_blind_measurements_of_the_largest_variance_are_still_solved():
    """Rank one and as large as is let in: the floor keeps the sum of two invertible."""
    blind = np.full((6, 6), (MAX_VARIANCE - 1) / 6)
    estimate = None
    for i in range(10):
        measurement = measure(pose(), pose((0, 0, 2)), blind, i)
        assert np.trace(measurement.covariance) <= MAX_VARIANCE
        estimate, _ = update(estimate, measurement)
    np.testing.assert_allclose(estimate.world_from_target.translation, (0, 0, 2), atol=1e-6)


@given(seeds, st.floats(0, 3), st.floats(0.1, 100))
def test_what_the_wire_lets_through_becomes_positive_definite(seed, magnitude, far_m):
    """A covariance may be as far below zero as the decoder's tolerance: -1e-9 of its trace."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    values = np.array([1.0, 1.0, 0.0, 0.0, -1e-9, -1e-9]) * 10**magnitude / 2
    m = measure(pose(), pose((0, 0, far_m)), (axes * values) @ axes.T, 0)
    np.linalg.cholesky(m.covariance)
    estimate, _ = update(estimate_at(pose((0, 0, far_m)), m.covariance), m)
    np.linalg.cholesky(estimate.covariance)


@pytest.mark.parametrize("seed", range(3))
def test_measure_turns_the_covariance_into_the_world(seed):
    """Monte Carlo: perturb the result and the odometry, and compare the samples' covariance."""
    rng = np.random.default_rng(seed)
    world_from_camera = pose(rng.normal(size=3), Rotation.random(rng=seed).as_rotvec())
    camera_from_target = pose((0.3, -0.2, 2.5), (0.4, -1.0, 0.3))
    a = rng.normal(size=(6, 6)) * np.repeat([0.02, 0.03], 3)[:, None]
    covariance_camera = a @ a.T
    n = 40_000
    d = rng.multivariate_normal(np.zeros(6), covariance_camera, size=n)  # (n, 6)

    f = rng.normal(size=(n, 3)) * USUAL_BUDGET.sigma_rad
    p = rng.normal(size=(n, 3)) * USUAL_BUDGET.sigma_m

    R_wc, R_ct = rotation_of(world_from_camera), rotation_of(camera_from_target)
    R_wt = R_wc * R_ct
    R_wc_samples = Rotation.from_rotvec(f) * R_wc
    R_wt_samples = R_wc_samples * Rotation.from_rotvec(d[:, 3:]) * R_ct
    t_wt = world_from_camera @ camera_from_target.translation
    t_ct_samples = camera_from_target.translation + d[:, :3]
    t_wt_samples = world_from_camera.translation + p + R_wc_samples.apply(t_ct_samples)
    in_world = np.hstack([t_wt_samples - t_wt, (R_wt_samples * R_wt.inv()).as_rotvec()])

    m = measure(world_from_camera, camera_from_target, covariance_camera, 5)
    expected = np.cov(in_world.T)
    # The standard error of a sample covariance is at most sqrt(2/n) of its variances.
    sigma = np.sqrt(np.diag(expected))
    assert np.abs((m.covariance - expected) / np.outer(sigma, sigma)).max() < 5 * np.sqrt(2 / n)
    np.testing.assert_allclose(m.world_from_target.translation, t_wt, atol=1e-12)
    assert (rotation_of(m.world_from_target) * R_wt.inv()).magnitude() < 1e-7
    assert m.t_capture_ns == 5


def test_range_is_from_the_camera_wherever_that_is():
    """The distance of the target in the camera, not in the world."""
    m = measure(pose((100, 0, 0), (0, 0, 1)), pose((0, 3, 4)), TIGHT, 0)
    assert m.range_m == pytest.approx(5.0)


@given(rotation=seeds)
def test_sigma_is_that_of_the_worst_axis(rotation):
    """However the ellipsoid lies."""
    R = Rotation.random(rng=rotation).as_matrix()
    covariance = np.eye(6)
    covariance[:3, :3] = R @ np.diag([1e-6, 4e-6, 9e-4]) @ R.T
    assert estimate_at(pose(), covariance).sigma_m == pytest.approx(0.03)


def test_a_measurement_that_is_older_than_the_estimate_adds_no_drift():
    """Time does not run backwards into the covariance (the gate refuses such results before)."""
    at = estimate_at(pose(), t_ns=SECOND)
    now, _ = update(at, seen_at(pose(), t_ns=SECOND))
    earlier, _ = update(at, replace(seen_at(pose()), t_capture_ns=0))
    np.testing.assert_array_equal(now.covariance, earlier.covariance)


def test_a_measurement_from_before_a_jump_changes_nothing():
    """Its place is told in a world that is no more, and neither fuses nor contradicts."""
    at = replace(estimate_at(pose((1, 2, 3))), epoch=3)
    for where in (pose((1, 2, 3)), pose((9, 9, 9))):
        done, verdict = update(at, replace(seen_at(where, t_ns=SECOND), epoch=2))
        assert verdict is Update.BEFORE_JUMP
        assert done is at


def test_the_first_measurement_after_a_jump_takes_the_estimates_place():
    """However near to the old one it is: nothing of the old covariance helps it."""
    at = replace(estimate_at(pose(), TIGHT / 100), outliers=2)
    done, verdict = update(at, replace(seen_at(pose((0.001, 0, 0)), t_ns=SECOND), epoch=1))
    assert verdict is Update.FIRST
    assert (done.epoch, done.outliers) == (1, 0)
    np.testing.assert_array_equal(done.covariance, TIGHT)
    assert update(done, replace(seen_at(pose(), t_ns=2 * SECOND), epoch=1))[1] is Update.FUSED


def test_the_usual_budget_is_what_the_documents_say():
    """A change of these numbers changes every estimate."""
    assert OdometryBudget(0.001, 0.005, 0.01, 0.005) == USUAL_BUDGET


def test_a_worse_odometry_is_counted_as_such():
    """Each number of a budget goes in where its text says, and stays with the estimate."""
    worse = OdometryBudget(0.003, 0.01, 0.04, 0.02)
    seen = measure(pose(), pose((0, 0, 2)), TIGHT, 0, budget=worse)
    growth = seen.covariance - measure(pose(), pose((0, 0, 2)), TIGHT, 0).covariance
    lateral = 0.003**2 - 0.001**2 + (0.01**2 - 0.005**2) * 2**2
    turn = 0.01**2 - 0.005**2
    expected = [lateral, lateral, 0.003**2 - 0.001**2, turn, turn, turn]
    np.testing.assert_allclose(np.diag(growth), expected)
    first, _ = update(None, seen, worse)
    assert first.budget == worse
    alone = replace(first, t_capture_ns=SECOND, t_confirmed_ns=0)
    widened = replace(alone, covariance=alone.covariance + np.diag([0.04**2] * 3 + [0.02**2] * 3))
    assert widened.seen_sigma_m == pytest.approx(first.sigma_m, rel=1e-9)


@pytest.mark.parametrize("name", list(OdometryBudget.__dataclass_fields__))
def test_a_budget_is_bounded(name):
    """Neither nothing nor everything, nor NaN; and the error names the field."""
    for value in (-1e-9, 1.0, np.nan):
        with pytest.raises(ValueError, match=name):
            replace(USUAL_BUDGET, **{name: value})
