"""Edge points measured on rendered discs, against the pose that rendered them."""

from __future__ import annotations

import numpy as np
import pytest

from rgbd_wire.camera import CameraIntrinsics
from target_pose.circle_edges import (
    circles_worth_measuring,
    measure_edges,
    printed_circles,
)
from target_pose.conic import CirclePose
from target_pose.fusion import fit_circles
from target_pose.target import load_target
from tests.unit.target_pose.render import Look, facing_pose, render_color

TARGET = load_target()
CIRCLES = printed_circles(TARGET)
LENS = (-0.055, 0.065, 0.0005, -0.0003, -0.02)


def camera(model="none", f=400.0):
    return CameraIntrinsics(320, 240, f, f, 161.0, 118.5, model, LENS)


def seen(pose, look, intrinsics=None, circles=CIRCLES, step_px=0.4, seed=0):
    intrinsics = intrinsics or camera()
    rng = np.random.default_rng(seed)
    image = render_color(TARGET, intrinsics, pose, look, rng)[..., 0]
    truth = CirclePose(pose.translation, pose.rotation[:, 0])
    return measure_edges(image, intrinsics, truth, circles, step_px), truth, intrinsics


@pytest.mark.parametrize("model", ["none", "brown_conrady", "inverse_brown_conrady"])
def test_the_edges_lie_on_the_circles_to_a_fiftieth_of_a_pixel(model):
    pose = facing_pose([0.2, -0.1, 1.2], 0.6, 0.8)
    edges, truth, intrinsics = seen(pose, Look(blur_px=0.8), camera(model))
    assert edges is not None
    fit = fit_circles(edges, intrinsics, truth)
    assert fit is not None
    assert fit.rms_px < 0.04
    assert np.linalg.norm(fit.pose.center - truth.center) < 1e-3


@pytest.mark.parametrize("blur", [0.6, 1.0, 1.6])
def test_the_blur_is_measured_with_pixel_and_interpolation_in_it(blur):
    edges, _, _ = seen(facing_pose([0, 0, 1.0], 0.3), Look(blur_px=blur), step_px=0.5)
    assert edges is not None
    # a pixel's square has variance 1/12, bilinear interpolation 1/6 in the mean
    assert edges.blur_px == pytest.approx(np.sqrt(blur**2 + 1 / 12 + 1 / 6), rel=0.1)


def test_the_curvature_correction_takes_the_bias_of_a_blurred_small_disc_out():
    """Its edge is 0.06 px inside: 0.25 % of this disc, a centimetre at four metres."""
    outer = CIRCLES[:1]
    pose = facing_pose([0, 0, 2.6], 0.4)
    edges, truth, _ = seen(pose, Look(blur_px=1.6), circles=outer, step_px=0.6)
    assert edges is not None
    fit = fit_circles(edges, camera(), truth)
    assert fit is not None
    shift_px = 0.5 * (1.6**2 + 0.25) / (0.15 * 400 / 2.6)
    bias_m = shift_px / (0.15 * 400 / 2.6) * 2.6
    assert abs(fit.pose.center[2] - 2.6) < 0.35 * bias_m


def test_points_next_to_another_printed_edge_count_for_little():
    pose = facing_pose([0, 0, 4.0], 0.2)
    edges, _, _ = seen(pose, Look(blur_px=1.0))
    assert edges is not None
    inner = edges.radius_m < 0.1
    assert edges.share[inner].mean() < 0.25 * edges.share[~inner].mean()


def test_which_circles_are_measured_depends_on_their_size():
    assert circles_worth_measuring(CIRCLES, 1000.0) == CIRCLES
    assert circles_worth_measuring(CIRCLES, 100.0) == CIRCLES[:2]
    assert circles_worth_measuring(CIRCLES, 20.0) == CIRCLES[:1]


def test_clearances_are_the_distances_to_the_next_printed_edge():
    assert [round(c.clearance_m, 6) for c in CIRCLES] == [0.05, 0.04, 0.04]
    assert [c.dark_inside for c in CIRCLES] == [True, False, True]


def test_circles_outside_the_picture_have_no_edges():
    truth = CirclePose(np.array([5.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0]))
    assert measure_edges(np.zeros((240, 320), np.uint8), camera(), truth, CIRCLES, 0.5) is None
