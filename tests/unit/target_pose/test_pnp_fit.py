"""Poses from points: exact projections, Jacobians, folds, and what is wrong with a point."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from rgbd_wire.geometry import Pose, rotation_from_vector, vector_from_rotation
from target_pose.covariance import pose_offset
from target_pose.fusion import SIZE_SIGMA
from target_pose.plane import InverseDepthPlane
from target_pose.pnp_fit import Measurements, fit_pose, predict_points
from target_pose.pnp_solve import planar_poses, sampled_poses
from target_pose.points import MIN_BREADTH, breadth
from tests.unit.target_pose.render import facing_pose

FOCAL = np.array([380.0, 390.0])
PLACES = np.array([[-0.15, 0.15], [0.15, 0.14], [0.14, -0.15], [-0.13, -0.12], [0.02, 0.05]])


def seen(pose, places):
    """Ideal pixels of a board's points, by OpenCV."""
    flat = np.column_stack([np.zeros(len(places)), places])
    k = np.diag([*FOCAL, 1.0])
    turn = cv2.Rodrigues(pose.rotation)[0]
    return cv2.projectPoints(flat, turn, pose.translation, k, None)[0][:, 0]


def measurements(pixels, places=PLACES, sigma=1.0):
    values = pixels.ravel()
    return Measurements(values, np.eye(len(values)) / sigma**2, predict_points(places, FOCAL))


@st.composite
def poses(draw, nearest=0.6, farthest=3.0, most_tilt_deg=65.0):
    """Boards in front of the camera, seen from the front."""
    z = draw(st.floats(nearest, farthest))
    center = z * np.array([draw(st.floats(-0.5, 0.5)), draw(st.floats(-0.4, 0.4)), 1.0])
    tilt = math.radians(draw(st.floats(0.0, most_tilt_deg)))
    azimuth, roll = draw(st.floats(0, 2 * math.pi)), draw(st.floats(-math.pi, math.pi))
    return facing_pose(center, tilt, azimuth, roll)


@st.composite
def boards(draw):
    """Points that span a board."""
    count = draw(st.integers(4, 12))
    coordinate = st.integers(-200, 200).map(lambda mm: mm / 1000)
    places = draw(
        st.lists(st.tuples(coordinate, coordinate), min_size=count, max_size=count, unique=True)
    )
    places = np.array(places)
    assume(breadth(places) >= 4 * MIN_BREADTH)
    assume(np.ptp(places, axis=0).min() > 0.1)
    apart = np.linalg.norm(places[:, None] - places, axis=2) + np.eye(count)
    assume(apart.min() > 0.03)
    return places


def off(got, want):
    return float(np.abs(pose_offset(got, want)).max())


@given(poses(), boards())
def test_exact_points_give_the_pose_back(pose, places):
    """Whatever the board and wherever it hangs, one of the solutions is the truth to 1e-6."""
    pixels = seen(pose, places)
    found = planar_poses(places, pixels, FOCAL)
    fits = [fit_pose(measurements(pixels, places), start) for start in found]
    assert min(off(fit.pose, pose) for fit in fits if fit is not None) < 1e-6


@pytest.mark.parametrize("tilt_deg", [20.0, 40.0, 60.0])
def test_both_folds_are_found(tilt_deg):
    """From afar a tilted board looks like its mirror image: both are local minima, the true best.

    The oracle is SciPy, started at the mirror image about the line of sight.
    """
    pose = facing_pose([0.3, -0.2, 2.5], math.radians(tilt_deg), 0.7, 0.2)
    pixels = seen(pose, PLACES)
    found = planar_poses(PLACES, pixels, FOCAL)
    assert len(found) == 2
    assert off(found[0], pose) < 1e-6

    def errors(x):
        rotation = rotation_from_vector(x[3:])
        return (seen(Pose.from_rotation(rotation, x[:3]), PLACES) - pixels).ravel()

    line = pose.translation / np.linalg.norm(pose.translation)
    half_turn = 2 * np.outer(line, line) - np.eye(3)
    normal = -half_turn @ -pose.rotation[:, 0]
    up = pose.rotation[:, 2] - normal * (normal @ pose.rotation[:, 2])
    up /= np.linalg.norm(up)
    mirrored = np.column_stack([normal, np.cross(up, normal), up])
    start = np.concatenate([pose.translation, cv2.Rodrigues(mirrored)[0].ravel()])
    other = least_squares(errors, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    want = Pose.from_rotation(rotation_from_vector(other.x[3:]), other.x[:3])
    assert off(found[1], want) < 1e-4


def test_four_points_with_three_on_a_line_are_enough():
    """A homography is not fixed by them; the second solver needs none."""
    places = np.array([[-0.15, -0.1], [0.0, -0.1], [0.15, -0.1], [0.05, 0.15]])
    pose = facing_pose([0.1, 0.1, 1.2], 0.6, 1.0, 0.3)
    found = planar_poses(places, seen(pose, places), FOCAL)
    assert min(off(p, pose) for p in found) < 1e-5


@given(poses(), st.floats(-0.01, 0.01))
def test_derivatives_are_those_of_finite_differences(pose, size):
    """By translation, by a turn on the left, and by the relative size."""
    predict = predict_points(PLACES, FOCAL)
    got = predict(pose.translation, pose.rotation, size)
    assert got.values == pytest.approx(seen(pose, PLACES * (1 + size)).ravel(), abs=1e-9)
    h = 1e-6
    for k in range(7):
        moved = []
        for sign in (h, -h):
            d = np.zeros(7)
            d[k] = sign
            rotation = rotation_from_vector(d[3:6]) @ pose.rotation
            moved.append(predict(pose.translation + d[:3], rotation, size + d[6]).values)
        numeric = (moved[0] - moved[1]) / (2 * h)
        assert got.jacobian[:, k] == pytest.approx(numeric, rel=1e-5, abs=1e-3)


@given(poses(most_tilt_deg=60.0), st.integers(0, 10_000))
def test_the_fit_is_scipys_minimum(pose, seed):
    """With noise, an independent solver stays where it is: size and its prior included."""
    rng = np.random.default_rng(seed)
    pixels = seen(pose, PLACES) + rng.normal(0, 0.3, (len(PLACES), 2))
    # where the search starts in earnest; the truth may lie on the saddle between the folds
    fit = fit_pose(measurements(pixels), planar_poses(PLACES, pixels, FOCAL)[0])

    def errors(x):
        moved = Pose.from_rotation(rotation_from_vector(x[3:6]) @ pose.rotation, x[:3])
        return np.append((seen(moved, PLACES * (1 + x[6])) - pixels).ravel(), x[6] / SIZE_SIGMA)

    turn = vector_from_rotation(fit.rotation @ pose.rotation.T)
    sizes = [errors(np.array([*fit.translation, *turn, s])) for s in (0.0, 1e-3)]
    slope = (sizes[1] - sizes[0]) / 1e-3
    size = -(slope @ sizes[0]) / (slope @ slope)  # the cost is all but quadratic in it
    start = np.array([*fit.translation, *turn, size])
    best = least_squares(errors, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert 2 * best.cost == pytest.approx(fit.cost, rel=1e-4, abs=1e-9)
    moved = Pose.from_rotation(rotation_from_vector(best.x[3:6]) @ pose.rotation, best.x[:3])
    assert off(fit.pose, moved) < 5e-3


def test_a_plane_turns_and_moves_the_fit_to_itself():
    """A plane of great weight: the fit lies on it, and the bearing stays that of the picture."""
    pose = facing_pose([0.1, -0.1, 1.5], 0.3, 0.5)
    plane_pose = facing_pose([0.1, -0.1, 1.503], 0.31, 0.5)
    normal = plane_pose.rotation[:, 0]
    coefficients = normal / (normal @ plane_pose.translation)
    plane = InverseDepthPlane(coefficients, 1e12 * np.eye(3), 100, 1e-4)
    fit = fit_pose(measurements(seen(pose, PLACES)), pose, plane)
    assert fit.normal == pytest.approx(normal, abs=1e-4)
    assert fit.normal / (fit.normal @ fit.translation) == pytest.approx(coefficients, abs=1e-5)
    bearing = fit.translation / fit.translation[2] - pose.translation / pose.translation[2]
    assert np.abs(bearing).max() < 1e-3


@pytest.mark.parametrize("wrong", [1, 3, 5])
def test_wrong_points_are_left_out(wrong):
    """Of twelve points up to five lie anywhere: they are sampled around, and weigh nothing."""
    rng = np.random.default_rng(wrong)
    places = rng.uniform(-0.2, 0.2, (12, 2))
    pose = facing_pose([0.2, 0.1, 1.2], 0.5, 2.0, 0.3)
    pixels = seen(pose, places) + rng.normal(0, 0.2, (12, 2))
    pixels[:wrong] += rng.uniform(15, 60, (wrong, 2)) * rng.choice([-1, 1], (wrong, 2))
    start = sampled_poses(places, pixels, FOCAL, good_px=1.0)[0]
    fit = fit_pose(measurements(pixels, places, 0.3), start, robust=True)
    assert not fit.weights.reshape(-1, 2)[:wrong].any()
    assert fit.weights.reshape(-1, 2)[wrong:].all()
    assert np.abs(pose_offset(fit.pose, pose)).max() < 0.03


def test_without_wrong_points_nothing_is_sampled():
    """The answer for all points, as it is."""
    pose = facing_pose([0.2, 0.1, 1.2], 0.5, 2.0, 0.3)
    places = np.vstack([PLACES, [[0.1, -0.05]]])
    pixels = seen(pose, places)
    whole = planar_poses(places, pixels, FOCAL)
    sampled = sampled_poses(places, pixels, FOCAL, good_px=1.0)
    assert [p.translation.tolist() for p in whole] == [p.translation.tolist() for p in sampled]


def test_mirrored_points_show_the_back_and_give_no_pose_of_the_front():
    """Left and right exchanged: what fits, if anything, is far from exact."""
    pose = facing_pose([0.0, 0.0, 1.0], 0.4, 1.0)
    pixels = seen(pose, PLACES * [-1, 1])
    poses_found = planar_poses(PLACES, pixels, FOCAL)
    for start in poses_found:
        fit = fit_pose(measurements(pixels), start)
        assert fit is None or fit.cost > 100
