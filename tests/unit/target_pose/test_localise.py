"""The whole ladder on rendered frames, and everything that must be refused."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose, vector_from_rotation
from target_pose.candidate import Box, Candidate
from target_pose.localisation import Localisation, Method, Refusal, RollSource
from target_pose.localise import MAX_TILT_RAD, localise
from target_pose.target import Level, load_target
from tests.unit.target_pose.render import (
    Look,
    facing_pose,
    render_color,
    render_depth,
    true_box,
)

TARGET = load_target()
LENS = (-0.055, 0.065, 0.0005, -0.0003, -0.02)
STEREO = {"noise": 2.5e-3, "smooth_px": 1.0, "holes": 0.2}


def rig(model="inverse_brown_conrady"):
    """A small camera as RealSense has them: two lenses, 59 mm apart."""
    color = CameraIntrinsics(320, 240, 300.0, 300.0, 161.0, 119.0, model, LENS)
    depth = CameraIntrinsics(240, 180, 200.0, 200.0, 120.5, 90.0)
    return RgbdCamera(color, depth, 0.001, Pose(np.array([-0.059, 0, 0]), [1.0, 0, 0, 0]))


def candidate_of(pose, camera, jitter_px=1.0, seed=0, levels=tuple(Level)):
    rng = np.random.default_rng(seed)
    boxes = {}
    for level in levels:
        side, square = TARGET.level_m[level], level is Level.GOOD
        box = np.array(true_box(TARGET, pose, camera.color, side, square))
        boxes[level] = Box(*(box + rng.normal(0, jitter_px, 4)), 0.9)
    return Candidate(boxes, 0.9)


def frame(pose, camera, look=None, seed=0, **sensor):
    rng = np.random.default_rng(seed)
    look = look or Look(noise=1.5, supersample=4)
    color = render_color(TARGET, camera.color, pose, look, rng)
    return color, render_depth(TARGET, camera, pose, look, rng, **(STEREO | sensor))


def located(pose, camera, look=None, depth=True, up=None, seed=0, **sensor):
    color, units = frame(pose, camera, look, seed, **sensor)
    found = localise(
        color, units if depth else None, camera, candidate_of(pose, camera), TARGET, up
    )
    assert isinstance(found, Localisation), found
    check(found)
    return found


def check(found):
    """What every answer has to fulfil."""
    c = found.covariance
    assert c.shape == (6, 6)
    assert np.isfinite(c).all()
    assert np.array_equal(c, c.T)
    assert np.linalg.eigvalsh(c).min() > 0
    pose = found.camera_from_target
    assert pose.translation[2] > 0
    assert pose.rotation[:, 0] @ pose.translation < 0
    assert not found.ambiguous or found.alternative is not None


def error(found, pose):
    """Position [m], normal [rad], roll [rad], and the squared Mahalanobis distance of all."""
    got = found.camera_from_target
    d = pose.translation - got.translation
    r = vector_from_rotation(pose.rotation @ got.rotation.T)
    normal = math.acos(min(1.0, float(pose.rotation[:, 0] @ got.rotation[:, 0])))
    e = np.concatenate([d, r])
    distance2 = float(e @ np.linalg.solve(found.covariance, e))
    return float(np.linalg.norm(d)), normal, abs(float(r @ pose.rotation[:, 0])), distance2


CHI2_6_999 = 22.5
POSES = [
    facing_pose([0.1, -0.05, 0.9], 0.5, 0.8, 0.1),
    facing_pose([-0.3, 0.2, 1.5], 0.05, 0.0, -0.2),
    facing_pose([0.3, 0.1, 2.4], 0.8, 3.0, 0.3),
]


@pytest.mark.parametrize("model", ["none", "brown_conrady", "inverse_brown_conrady"])
@pytest.mark.parametrize("pose", POSES)
def test_picture_and_depth_together_give_the_pose(pose, model):
    found = located(pose, rig(model))
    position, normal, roll, distance2 = error(found, pose)
    assert found.method is Method.FUSED
    assert found.roll_source is RollSource.EDGES
    assert position < 4e-3 * pose.translation[2]
    assert normal < math.radians(1.5)
    assert roll < math.radians(1)
    assert distance2 < CHI2_6_999
    assert not found.depth_contradicts
    assert found.plane_inliers > 30
    assert max(found.ellipse_points, found.picture_points) > 50
    for range_m in (found.range_ellipse_m, found.range_plane_m):
        assert range_m == pytest.approx(float(np.linalg.norm(pose.translation)), rel=0.02)


def test_one_box_of_any_level_is_enough():
    pose, camera = POSES[0], rig()
    color, units = frame(pose, camera)
    for level in Level:
        found = localise(color, units, camera, candidate_of(pose, camera, levels=(level,)), TARGET)
        assert isinstance(found, Localisation)
        assert error(found, pose)[0] < 4e-3


def test_without_depth_the_circles_give_the_pose_and_the_inner_one_picks_the_fold():
    pose = POSES[0]
    found = located(pose, rig(), depth=False)
    position, normal, _, distance2 = error(found, pose)
    assert found.method is Method.ELLIPSE
    assert not found.ambiguous
    assert position < 5e-3
    assert normal < math.radians(1)
    assert distance2 < CHI2_6_999
    assert found.range_plane_m is None


def test_far_away_the_folds_cannot_be_told_apart_and_the_covariance_spans_both():
    unsure = 0
    for azimuth in np.linspace(0, 2 * math.pi, 7)[:-1]:
        pose = facing_pose([0.2, 0.1, 8.0], 0.6, azimuth)
        look = Look(noise=6.0, blur_px=1.0, supersample=4)
        found = located(pose, rig(), depth=False, look=look)
        assert found.method is Method.ELLIPSE
        assert found.alternative is not None
        normals = [p.rotation[:, 0] for p in (found.camera_from_target, found.alternative)]
        assert max(n @ pose.rotation[:, 0] for n in normals) > math.cos(math.radians(8))
        if found.ambiguous:
            unsure += 1
            assert error(found, pose)[3] < CHI2_6_999
            # at the least sure that it may be, the other fold is one in ninety
            assert error(found, found.alternative)[3] < 92
    assert unsure >= 2


@pytest.mark.parametrize("azimuth", np.linspace(0, 2 * math.pi, 7)[:-1])
def test_the_plane_picks_the_fold_where_the_circles_cannot(azimuth):
    pose = facing_pose([0.2, 0.1, 3.0], 0.6, azimuth)
    found = located(pose, rig(), noise=1e-3)
    assert found.method is Method.FUSED
    assert error(found, pose)[1] < math.radians(4)
    assert found.alternative is not None
    other = found.alternative.rotation[:, 0] @ pose.rotation[:, 0]
    assert other < math.cos(math.radians(30))


def test_a_black_picture_leaves_the_plane_and_the_box_s_bearing():
    pose, camera = POSES[0], rig()
    _, units = frame(pose, camera)
    black = np.zeros((240, 320, 3), np.uint8)
    found = localise(black, units, camera, candidate_of(pose, camera), TARGET)
    assert isinstance(found, Localisation)
    check(found)
    position, normal, _, distance2 = error(found, pose)
    assert found.method is Method.DEPTH
    assert position < 0.03
    assert normal < math.radians(4)
    assert distance2 < CHI2_6_999


def test_a_black_picture_without_depth_leaves_the_box():
    pose, camera = POSES[1], rig()
    black = np.zeros((240, 320, 3), np.uint8)
    nothing = np.zeros((180, 240), np.uint16)
    for units in (None, nothing):
        found = localise(black, units, camera, candidate_of(pose, camera), TARGET)
        assert isinstance(found, Localisation)
        check(found)
        assert found.method is Method.BOX
        assert error(found, pose)[0] < 0.15 * pose.translation[2]
        assert error(found, pose)[3] < CHI2_6_999


def test_gravity_gives_the_roll_where_the_board_has_no_edges_to_see():
    pose = POSES[0]
    white = Look(wall=215.0, supersample=3)
    up = pose.rotation[:, 2] * 9.81
    found = located(pose, rig(), look=white, up=up)
    assert found.roll_source is RollSource.GRAVITY
    assert error(found, pose)[2] < math.radians(0.5)
    for useless in (np.zeros(3), np.full(3, np.nan), np.full(3, 1e300)):
        assert located(pose, rig(), look=white, up=useless).roll_source is RollSource.ASSUMED


@pytest.mark.parametrize("scale", [0.2, 0.5, 1.5, 5.0])
def test_a_wrong_depth_unit_is_refused(scale):
    """With it, one of picture and depth lies, and nothing here can know which."""
    pose, camera = POSES[0], rig("none")
    color, units = frame(pose, camera)
    aligned = replace(camera, depth=camera.color, color_from_depth=Pose.identity())
    units = render_depth(TARGET, aligned, pose, None, np.random.default_rng(0), **STEREO)
    wrong = replace(aligned, depth_scale_m=0.001 * scale)
    found = localise(color, units, wrong, candidate_of(pose, camera), TARGET)
    assert found is Refusal.INCONSISTENT


def test_depth_that_is_a_little_off_is_left_out_and_said_so():
    pose = POSES[0]
    found = located(pose, rig(), bias=0.08)
    assert found.method is Method.ELLIPSE
    assert found.depth_contradicts
    assert found.range_plane_m is not None
    ray = pose.translation / np.linalg.norm(pose.translation)
    sigma = math.sqrt(ray @ found.covariance[:3, :3] @ ray)
    assert sigma > 0.9 * abs(found.range_plane_m - found.range_ellipse_m)


def test_a_black_picture_with_a_wrong_depth_unit_is_refused():
    pose, camera = POSES[0], rig()
    _, units = frame(pose, camera)
    wrong = replace(camera, depth_scale_m=0.0025)
    black = np.zeros((240, 320, 3), np.uint8)
    big = Candidate({Level.BETTER: Box(20, 20, 120, 120, 0.9)}, 0.9)
    assert localise(black, units, wrong, big, TARGET) is Refusal.INCONSISTENT


def test_an_arm_across_the_board_does_not_move_the_pose():
    pose, camera = POSES[0], rig()
    color, units = frame(pose, camera)
    (u, v) = true_box(TARGET, pose, camera.color, 0.3, square=False)[:2]
    cv2.rectangle(color, (int(u) + 30, 0), (int(u) + 42, int(v) + 30), (90, 60, 30), -1)
    units[:, :90] = np.where(units[:, :90] > 0, 350, 0)
    found = localise(color, units, camera, candidate_of(pose, camera), TARGET)
    assert isinstance(found, Localisation)
    assert error(found, pose)[0] < 6e-3
    assert error(found, pose)[3] < CHI2_6_999


@pytest.mark.parametrize("depth", [True, False])
def test_a_grazing_view_is_refused_or_not_sure(depth):
    camera = rig()
    for tilt_deg in (74, 78, 82):
        pose = facing_pose([0.1, 0.0, 1.2], math.radians(tilt_deg), 0.5)
        color, units = frame(pose, camera)
        boxes = candidate_of(pose, camera)
        found = localise(color, units if depth else None, camera, boxes, TARGET)
        if isinstance(found, Localisation):
            check(found)
            assert error(found, pose)[3] < 4 * CHI2_6_999
            assert found.method in (Method.BOX, Method.DEPTH) or tilt_deg < 78
        else:
            assert found in (Refusal.GRAZING, Refusal.INCONSISTENT, Refusal.BAD_BOX)
    assert math.degrees(MAX_TILT_RAD) == pytest.approx(72)


def test_a_target_of_a_few_pixels_is_refused():
    camera = rig()
    pose = facing_pose([0.0, 0.0, 15.0])
    color, units = frame(pose, camera)
    found = localise(color, units, camera, candidate_of(pose, camera, 0.0), TARGET)
    assert found is Refusal.TOO_SMALL


def test_pictures_that_do_not_fit_the_camera_are_refused():
    pose, camera = POSES[0], rig()
    color, units = frame(pose, camera)
    boxes = candidate_of(pose, camera)
    bad = [
        (color[:-1], units, None),
        (color[..., 0], units, None),
        (color.astype(np.float32), units, None),
        (color, units[:, :-1], None),
        (color, units.astype(np.float32), None),
        (color, units, np.zeros(4)),
    ]
    for picture, depth, up in bad:
        assert localise(picture, depth, camera, boxes, TARGET, up) is Refusal.BAD_INPUT


def test_boxes_outside_the_picture_and_no_boxes_are_refused():
    camera = rig()
    color, units = frame(POSES[0], camera)
    for boxes in ({}, {Level.BETTER: Box(400, 10, 460, 70, 0.9)}):
        assert localise(color, units, camera, Candidate(boxes, 0.9), TARGET) is Refusal.BAD_BOX


def test_a_lens_without_inverse_where_the_target_is_is_refused():
    folded = CameraIntrinsics(
        320, 240, 300.0, 300.0, 160.0, 120.0, "brown_conrady", (-20.0, 0.0, 0.0, 0.0, 0.0)
    )
    camera = RgbdCamera(folded, folded, 0.001, Pose.identity())
    color = np.full((240, 320, 3), 120, np.uint8)
    corner = Candidate({Level.BETTER: Box(250, 180, 310, 235, 0.9)}, 0.9)
    assert localise(color, None, camera, corner, TARGET) is Refusal.BAD_INTRINSICS


def test_a_box_that_two_borders_cut_with_nothing_in_it_is_no_evidence():
    camera = rig()
    black = np.zeros((240, 320, 3), np.uint8)
    corner = Candidate({Level.BETTER: Box(280, 200, 320, 240, 0.9)}, 0.9)
    assert localise(black, None, camera, corner, TARGET) is Refusal.NO_EVIDENCE


boxes = st.builds(
    Box,
    *[st.floats(-60, 400) | st.floats(allow_nan=True, allow_infinity=True)] * 4,
    st.floats(0, 1),
)
cameras = st.builds(
    lambda model, k, scale, t: RgbdCamera(
        CameraIntrinsics(160, 120, 150.0, 140.0, 80.0, 60.0, model, k),
        CameraIntrinsics(120, 90, 100.0, 100.0, 60.0, 45.0, model, k),
        scale,
        Pose(np.array([t, 0, 0]), [1.0, 0, 0, 0]),
    ),
    st.sampled_from(["none", "brown_conrady", "inverse_brown_conrady"]),
    st.tuples(*[st.floats(-0.3, 0.3) | st.floats(-100, 100)] * 5),
    st.floats(1e-5, 0.1),
    st.floats(-0.2, 0.2) | st.floats(-10, 10),
)


def any_picture(rng, kind):
    """Noise, smooth blotches, flat grey, or hard-edged discs anywhere; and a box in it."""
    shape = (120, 160)
    box = rng.uniform(0, 120, 4)
    if kind == 0:
        gray = rng.integers(0, 256, shape)
    elif kind == 1:
        gray = cv2.GaussianBlur(rng.random(shape), (0, 0), 6) * 4096 % 256
    elif kind == 2:
        gray = np.full(shape, rng.integers(0, 256))
    else:
        gray = np.full(shape, 220, np.uint8)
        for k in range(6):
            u, v = (int(c) for c in rng.integers(0, 160, 2))
            a, b = (int(a) for a in rng.integers(2, 60, 2))
            tone = int(rng.integers(0, 256)) if k < 3 else 20
            cv2.ellipse(gray, (u, v), (a, b), float(rng.integers(0, 90)), 0, 360, tone, -1)
        cv2.ellipse(gray, (u, v), (a // 2, b // 2), 30, 0, 360, 230, -1)
        box = np.array([u - a, v - b, u + a, v + b])
    gray = cv2.GaussianBlur(gray.astype(np.uint8), (0, 0), 0.3 + rng.random())
    return np.repeat(gray[..., None], 3, axis=2), Box(*box.astype(float), 0.5)


@settings(deadline=None, max_examples=150)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 3),
    st.integers(0, 3),
    cameras,
    st.dictionaries(st.sampled_from(list(Level)), boxes),
    st.none() | st.tuples(*[st.floats()] * 3).map(np.array),
)
def test_nothing_makes_it_raise(seed, picture, depth_kind, camera, levels, up):
    rng = np.random.default_rng(seed)
    color, fitting = any_picture(rng, picture)
    if Level.BETTER not in levels:
        levels = levels | {Level.BETTER: fitting}
    units = [
        np.zeros((90, 120), np.uint16),
        rng.integers(0, 65536, (90, 120)).astype(np.uint16),
        np.full((90, 120), rng.integers(0, 65536), np.uint16),
        None,
    ][depth_kind]
    found = localise(color, units, camera, Candidate(levels, 0.5), TARGET, up)
    if isinstance(found, Refusal):
        return
    check(found)
    if found.alternative is not None:
        assert np.isfinite(found.alternative.translation).all()


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(0.3, 4.0),
    st.floats(0, 1.5),
    st.floats(0, 2 * math.pi),
    st.floats(0, 0.95),
    st.floats(0, 1),
)
def test_a_target_half_hidden_in_any_way_is_placed_or_refused(seed, z, tilt, azimuth, hidden, dim):
    rng = np.random.default_rng(seed)
    camera = RgbdCamera(
        CameraIntrinsics(160, 120, 150.0, 150.0, 80.0, 60.0),
        CameraIntrinsics(120, 90, 100.0, 100.0, 60.0, 45.0),
        0.001,
        Pose(np.array([-0.059, 0, 0]), [1.0, 0, 0, 0]),
    )
    pose = facing_pose([0.2 * z * rng.uniform(-1, 1), 0.1 * z, z], tilt, azimuth)
    look = Look(supersample=2, noise=3.0, dim=dim)
    color = render_color(TARGET, camera.color, pose, look, rng)
    units = render_depth(TARGET, camera, pose, look, rng, **STEREO)
    x0, y0, x1, y1 = true_box(TARGET, pose, camera.color, 0.4, square=True)
    color[max(int(y0), 0) : max(int(y0 + hidden * (y1 - y0)), 0)] = 90
    found = localise(color, units, camera, candidate_of(pose, camera, seed=seed), TARGET)
    if isinstance(found, Localisation):
        check(found)
