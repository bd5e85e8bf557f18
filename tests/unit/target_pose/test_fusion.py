"""Circle edges and plane fused: derivatives, recovery, and what each source is worth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import rotation_from_vector
from target_pose.circle_edges import CircleEdges
from target_pose.conic import CirclePose, other_fold
from target_pose.covariance import covariance_from_information
from target_pose.fusion import fit_circles, plane_error
from target_pose.plane import InverseDepthPlane

CAMERA = CameraIntrinsics(640, 480, 600.0, 600.0, 320.0, 240.0)


def pose_at(center, tilt, azimuth):
    center = np.asarray(center, dtype=float)
    ray = center / np.linalg.norm(center)
    across = np.cross(ray, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    side = math.cos(azimuth) * across + math.sin(azimuth) * np.cross(ray, across)
    return CirclePose(center, -math.cos(tilt) * ray + math.sin(tilt) * side)


def edges_of(pose, radii=(0.15, 0.07), shift_px=0.0, noise_px=0.0, seed=0):
    """Exact edge points, each moved along the outline's normal in the picture."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.svd(pose.normal[None])[2][1:]
    a = np.linspace(0, 2 * math.pi, 64, endpoint=False)
    rim = np.stack([np.cos(a), np.sin(a)], axis=1) @ basis
    xy, radius, dark = [], [], []
    for k, r in enumerate(radii):
        points = pose.center + r * rim
        uv = points[:, :2] / points[:, 2:]
        tangent = np.roll(uv, -1, axis=0) - np.roll(uv, 1, axis=0)
        normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        normal *= np.sign(((uv - uv.mean(axis=0)) * normal).sum(axis=1))[:, None]
        side = 1.0 if k % 2 == 0 else -1.0
        along = -side * shift_px + noise_px * rng.standard_normal(64)
        xy.append(uv + normal * along[:, None] / 600)
        radius.append(np.full(64, r))
        dark.append(np.full(64, side))
    flat = [np.concatenate(part) for part in (xy, radius, dark)]
    return CircleEdges(flat[0], flat[1], flat[2], np.ones(len(flat[1])), 0.8)


def plane_of(pose, sigma=1e-3):
    coefficients = pose.normal / float(pose.normal @ pose.center)
    return InverseDepthPlane(coefficients, np.eye(3) / sigma**2, 1000, sigma)


poses = st.builds(
    pose_at,
    st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.8, 3.0)),
    st.floats(0.2, 1.1),
    st.floats(0, 2 * math.pi),
)


@settings(deadline=None, max_examples=30)
@given(poses)
def test_exact_edges_give_back_the_pose_from_a_rough_start(pose):
    turn = rotation_from_vector(np.array([0.03, -0.04, 0.02]))
    start = CirclePose(pose.center * 1.02, turn @ pose.normal)
    fit = fit_circles(edges_of(pose), CAMERA, start)
    assert fit is not None
    np.testing.assert_allclose(fit.pose.center, pose.center, atol=2e-4)
    np.testing.assert_allclose(fit.pose.normal, pose.normal, atol=2e-3)
    assert fit.rms_px < 1e-2


@settings(deadline=None, max_examples=20)
@given(poses, st.integers(0, 2**32 - 1))
def test_the_plane_s_derivatives_are_those_of_finite_differences(pose, seed):
    plane = plane_of(pose_at((0.1, 0.1, 1.5), 0.3, 1.0))
    _, jacobian = plane_error(plane, *pose)
    step = 1e-6
    for k in range(6):
        delta = np.zeros(6)
        delta[k] = step
        ahead, _ = plane_error(
            plane, pose.center + delta[:3], rotation_from_vector(delta[3:]) @ pose.normal
        )
        behind, _ = plane_error(
            plane, pose.center - delta[:3], rotation_from_vector(-delta[3:]) @ pose.normal
        )
        np.testing.assert_allclose(jacobian[:, k], (ahead - behind) / (2 * step), atol=1e-5)


def test_a_shift_towards_the_dark_side_is_seen_by_the_inner_circle_and_taken_out():
    """A tone curve moves every edge so; from the outer circle alone it would be range."""
    pose = pose_at((0.1, 0.05, 2.0), 0.6, 0.7)
    both = fit_circles(edges_of(pose, shift_px=0.3), CAMERA, pose)
    outer = fit_circles(edges_of(pose, radii=(0.15,), shift_px=0.3), CAMERA, pose)
    assert both is not None
    assert outer is not None
    assert np.linalg.norm(both.pose.center - pose.center) < 1.5e-3
    assert np.linalg.norm(outer.pose.center - pose.center) > 5e-3


def test_without_the_inner_circle_the_range_is_less_sure():
    pose = pose_at((0.1, 0.05, 2.0), 0.6, 0.7)
    both = fit_circles(edges_of(pose), CAMERA, pose)
    outer = fit_circles(edges_of(pose, radii=(0.15,)), CAMERA, pose)
    assert both is not None
    assert outer is not None
    ray = pose.center / np.linalg.norm(pose.center)

    def range_sigma(fit):
        covariance = covariance_from_information(fit.information, pose.normal, pose.center, 0.1)
        return math.sqrt(ray @ covariance[:3, :3] @ ray)

    assert range_sigma(outer) > 2 * range_sigma(both)


def test_outliers_up_to_a_third_of_the_edge_have_no_say():
    """A cable or the drone's own arm across the board."""
    pose = pose_at((0.0, 0.1, 1.5), 0.5, 2.0)
    edges = edges_of(pose, noise_px=0.05)
    edges.xy[:20] += 0.01
    edges.xy[64:84] -= 0.008
    fit = fit_circles(edges, CAMERA, pose)
    assert fit is not None
    assert np.linalg.norm(fit.pose.center - pose.center) < 2e-3
    # one moved along the edge still lies on it
    assert np.count_nonzero(fit.inliers[:20]) <= 2


def test_a_frontal_circle_takes_its_normal_from_the_plane():
    pose = pose_at((0.0, 0.01, 2.0), 0.02, 0.0)
    tilted = CirclePose(pose.center, rotation_from_vector(np.array([0.0, 0.05, 0.0])) @ pose.normal)
    edges = edges_of(pose, noise_px=0.05)
    free = fit_circles(edges, CAMERA, tilted)
    fused = fit_circles(edges, CAMERA, tilted, plane_of(pose))
    assert free is not None
    assert fused is not None
    assert math.acos(min(1.0, float(fused.pose.normal @ pose.normal))) < 0.01
    tilt = np.array([0.0, 0, 0, 0, 1, 0])
    assert tilt @ fused.information @ tilt > 2 * (tilt @ free.information @ tilt)


def test_the_fused_range_is_the_mean_weighted_by_inverse_variance():
    """With the plane moved by a known part, the result moves by the part that its weight has."""
    pose = pose_at((0.0, 0.0, 2.0), 0.7, 0.4)
    edges = edges_of(pose)
    free = fit_circles(edges, CAMERA, pose)
    assert free is not None
    plane = plane_of(pose, sigma=2e-3)
    moved = InverseDepthPlane(
        plane.coefficients * 1.002, plane.information, plane.inliers, plane.sigma
    )
    fused = fit_circles(edges, CAMERA, pose, moved)
    assert fused is not None
    prior = 1e-6 * np.eye(6)
    prior[3:, 3:] += 1e6 * np.outer(pose.normal, pose.normal)
    error, jacobian = plane_error(moved, *pose)
    weight = jacobian.T @ moved.information
    expected = -np.linalg.solve(free.information + prior + weight @ jacobian, weight @ error)
    got = fused.pose.center - pose.center
    np.testing.assert_allclose(got, expected[:3], atol=0.1 * np.abs(expected[:3]).max())


def test_the_wrong_fold_costs_more_where_the_inner_circle_is_seen():
    pose = pose_at((0.1, 0.0, 0.8), 0.7, 0.0)
    edges = edges_of(pose, noise_px=0.05)
    right = fit_circles(edges, CAMERA, pose)
    wrong = fit_circles(edges, CAMERA, other_fold(pose, 0.15))
    assert right is not None
    assert wrong is not None
    assert wrong.cost(right.sigma) > right.cost(right.sigma) + 9


@pytest.mark.parametrize("z", [-1.0, 0.0])
def test_a_start_behind_the_camera_has_no_fit(z):
    pose = pose_at((0.1, 0.0, 0.8), 0.7, 0.0)
    start = CirclePose(np.array([0.1, 0.0, z]), pose.normal)
    assert fit_circles(edges_of(pose), CAMERA, start) is None
