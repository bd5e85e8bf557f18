"""The paper's method: labelled points and boards' corners to poses, and what must be refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, kstest

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose, rotation_from_vector, vector_from_rotation
from target_pose.candidate import Box, Candidate
from target_pose.covariance import BEARING_SIGMA_RAD
from target_pose.fusion import SIZE_SIGMA
from target_pose.localisation import Localisation, Method, Refusal, RollSource
from target_pose.pnp import localise_pnp
from target_pose.pnp_boxes import measure_boxes
from target_pose.pnp_corners import corner_places, measure_corners
from target_pose.pnp_points import SIGMA_PX, SIGMA_SHARE
from target_pose.points import BoardPoint, PointPx
from target_pose.target import Level, Shade, Target, load_target
from tests.unit.target_pose.render import (
    Look,
    facing_pose,
    render_color,
    render_depth,
    seen_pixels,
    true_box,
)

BULLSEYE = load_target()
LENS = (-0.055, 0.065, 0.0005, -0.0003, -0.02)
MODELS = ["none", "brown_conrady", "inverse_brown_conrady"]
STEREO = {"noise": 2.5e-3, "smooth_px": 1.0, "holes": 0.2}
POSE = facing_pose([0.1, -0.05, 1.0], 0.5, 0.8, 0.1)
BLANK = np.full((240, 320, 3), 120, np.uint8)


def rig(model="inverse_brown_conrady"):
    """A small camera as RealSense has them: two lenses, 59 mm apart."""
    color = CameraIntrinsics(320, 240, 300.0, 300.0, 161.0, 119.0, model, LENS)
    depth = CameraIntrinsics(240, 180, 200.0, 200.0, 120.5, 90.0)
    return RgbdCamera(color, depth, 0.001, Pose(np.array([-0.059, 0, 0]), [1.0, 0, 0, 0]))


def panel(count=8, seed=3):
    """A board of 0.4 m with labelled points that are nowhere in particular."""
    places = np.random.default_rng(seed).uniform(-0.19, 0.19, (count - 4, 2)).round(3)
    places = [(-0.18, 0.17), (0.17, 0.18), (0.18, -0.16), (-0.17, -0.18), *places.tolist()]
    points = tuple(BoardPoint(f"p{k}", y, z) for k, (y, z) in enumerate(places))
    return Target("panel", 0.4, Shade.WHITE, (), {Level.GOOD: 0.4}, points=points)


PANEL = panel()


def pixels_of(target, pose, camera, size=1.0):
    places = np.array([(0.0, p.y_m, p.z_m) for p in target.points]) * size
    return seen_pixels(pose @ places, camera.color)


def candidate_of(target, uv, confidence=0.9):
    confidence = np.broadcast_to(confidence, len(uv))
    points = {
        p.name: PointPx(float(u), float(v), float(c))
        for p, (u, v), c in zip(target.points, uv, confidence, strict=True)
    }
    return Candidate({Level.GOOD: Box(100.0, 60.0, 220.0, 180.0, 0.9)}, 0.9, points)


def on_points(uv, camera, target=PANEL, depth=None):
    return localise_pnp(BLANK, depth, camera, candidate_of(target, uv), target)


def bullseye_candidate(pose, camera, jitter_px=1.0, seed=0, levels=tuple(Level)):
    rng = np.random.default_rng(seed)
    boxes = {}
    for level in levels:
        side, square = BULLSEYE.level_m[level], level is Level.GOOD
        box = np.array(true_box(BULLSEYE, pose, camera.color, side, square))
        boxes[level] = Box(*(box + rng.normal(0, jitter_px, 4)), 0.9)
    return Candidate(boxes, 0.9)


def check(found):
    """What every answer has to fulfil."""
    assert isinstance(found, Localisation), found
    assert found.method is Method.PNP
    c = found.covariance
    assert np.array_equal(c, c.T)
    assert np.linalg.eigvalsh(c).min() > 0
    pose = found.camera_from_target
    assert pose.rotation[:, 0] @ pose.translation < 0
    assert not found.ambiguous or found.alternative is not None
    return found


def error(found, pose):
    """Position [m], normal [rad], the six numbers' squared Mahalanobis distance."""
    got = check(found).camera_from_target
    d = pose.translation - got.translation
    r = vector_from_rotation(pose.rotation @ got.rotation.T)
    normal = math.acos(min(1.0, float(pose.rotation[:, 0] @ got.rotation[:, 0])))
    e = np.concatenate([d, r])
    return float(np.linalg.norm(d)), normal, float(e @ np.linalg.solve(found.covariance, e))


# labelled points


@given(
    st.sampled_from(MODELS),
    st.floats(-0.25, 0.25),
    st.floats(-0.15, 0.15),
    st.floats(0.9, 2.5),
    st.floats(0, 1.1),
    st.floats(0, 6.28),
    st.floats(-math.pi, math.pi),
)
def test_exact_points_give_the_pose_through_any_lens(model, x, y, z, tilt, azimuth, roll):
    """To 1e-6 m and rad, the roll included: no gravity and no edge is needed."""
    pose = facing_pose([x * z, y * z, z], tilt, azimuth, roll)
    camera = rig(model)
    found = on_points(pixels_of(PANEL, pose, camera), camera)
    position, _, _ = error(found, pose)
    turn = pose.rotation @ found.camera_from_target.rotation.T
    assert position < 1e-6
    assert np.linalg.norm(vector_from_rotation(turn)) < 1e-6
    assert found.roll_source is RollSource.POINTS
    assert 6 <= found.ellipse_points <= len(PANEL.points)  # some lie outside of the picture
    assert found.ellipse_rms_px < 1e-4


@pytest.mark.parametrize(("count", "noise"), [(4, 1.0), (6, 1.0), (12, 1.0), (30, 1.8)])
def test_the_covariance_is_that_of_the_errors(count, noise):
    """Squared Mahalanobis distances follow chi-square with six degrees of freedom.

    The truth errs as the docs say that it may: bearing by calibration, size by print and focal
    length, points by the expected noise or, where there are enough to measure it, by another.
    """
    rng = np.random.default_rng(count)
    target, camera = panel(count), rig("none")
    distances = []
    for _ in range(160):
        tilt, azimuth = rng.uniform(0.5, 0.9), rng.uniform(0, 6.28)
        pose = facing_pose([0.05, 0.02, 0.85], tilt, azimuth, rng.uniform(-3, 3))
        size = 1 + rng.normal(0, SIZE_SIGMA)
        uv = pixels_of(target, pose, camera, size)
        sigma = noise * math.hypot(SIGMA_PX, SIGMA_SHARE * np.ptp(uv, axis=0).max())
        uv = uv + rng.normal(0, sigma, uv.shape) + rng.normal(0, 300 * BEARING_SIGMA_RAD, 2)
        found = on_points(uv, camera, target)
        if found is not Refusal.POINTS_DISAGREE:  # the tail of two left-over numbers
            distances.append(error(found, pose)[2])
    assert len(distances) >= 158
    for share in (0.5, 0.95, 0.99):
        got = np.mean(np.array(distances) < chi2.ppf(share, 6))
        assert got == pytest.approx(share, abs=0.08)
    assert kstest(distances, chi2(6).cdf).pvalue > 1e-3


def test_depth_narrows_the_covariance_and_the_error():
    """Points with noise: the plane gives the range, and the answer says how far it was alone."""
    camera, rng = rig(), np.random.default_rng(5)
    with_depth, without = [], []
    for k in range(12):
        units = render_depth(PANEL, camera, POSE, None, np.random.default_rng(k), **STEREO)
        uv = pixels_of(PANEL, POSE, camera) + rng.normal(0, 1.5, (8, 2))
        fused, alone = on_points(uv, camera, depth=units), on_points(uv, camera)
        with_depth.append(error(fused, POSE))
        without.append(error(alone, POSE))
        assert with_depth[-1][2] < chi2.ppf(0.999, 6)
        assert fused.plane_inliers > 30
        assert fused.range_plane_m == pytest.approx(np.linalg.norm(POSE.translation), rel=0.02)
        assert alone.range_plane_m is None
        assert np.trace(fused.covariance[:3, :3]) < np.trace(alone.covariance[:3, :3])
    assert np.median(with_depth, axis=0)[0] < np.median(without, axis=0)[0]
    assert np.median(with_depth, axis=0)[1] < np.median(without, axis=0)[1]


def test_far_away_both_folds_fit_and_the_depth_tells_which():
    """Without depth the answer spans both; with it there is one, the right one."""
    camera, rng = rig(), np.random.default_rng(1)
    unsure = 0
    for k in range(8):
        pose = facing_pose([0.2, 0.1, 3.5], 0.6, k * math.pi / 4)
        uv = pixels_of(PANEL, pose, camera) + rng.normal(0, 0.7, (8, 2))
        alone = check(on_points(uv, camera))
        unsure += alone.ambiguous
        assert error(alone, pose)[2] < chi2.ppf(0.999, 6)
        if alone.ambiguous:
            poses = (alone.camera_from_target, alone.alternative)
            assert max(p.rotation[:, 0] @ pose.rotation[:, 0] for p in poses) > math.cos(0.2)
        units = render_depth(PANEL, camera, pose, None, np.random.default_rng(k), **STEREO)
        fused = check(on_points(uv, camera, depth=units))
        assert not fused.ambiguous
        assert error(fused, pose)[1] < math.radians(8)
    assert unsure >= 4


def test_points_at_the_border_or_without_confidence_are_not_used():
    """A net gives them some place: what lies outside is drawn to the border, or guessed."""
    camera = rig()
    uv = pixels_of(PANEL, POSE, camera)
    uv[0], uv[1] = (0.0, 100.0), (320.0, -3.0)
    confidence = np.full(8, 0.9)
    uv[2] += 40
    confidence[2] = 0.2
    found = localise_pnp(BLANK, None, camera, candidate_of(PANEL, uv, confidence), PANEL)
    assert error(found, POSE)[0] < 1e-6
    assert found.ellipse_points == 5


def test_one_wrong_point_of_many_is_left_out():
    """It is fitted around, not averaged in."""
    camera = rig()
    uv = pixels_of(PANEL, POSE, camera)
    uv[3] += (25, -30)
    found = on_points(uv, camera)
    assert error(found, POSE)[0] < 1e-6
    assert found.ellipse_points == 7


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda uv: uv[:, ::-1] + [40, -40], Refusal.POINTS_DISAGREE),
        (lambda uv: uv[[1, 0, 2, 3, 4, 5, 6, 7]] + 0.5, None),
        (lambda uv: uv[[4, 5, 6, 7, 0, 1, 2, 3]], Refusal.POINTS_DISAGREE),
        (lambda uv: np.random.default_rng(0).uniform(40, 200, uv.shape), Refusal.POINTS_DISAGREE),
        (lambda uv: 160 + (uv - 160) * 0.02, Refusal.TOO_SMALL),
        (lambda uv: np.where(np.arange(8)[:, None] < 5, np.nan, uv), Refusal.NO_EVIDENCE),
        (lambda uv: uv + 1000, Refusal.NO_EVIDENCE),
        (lambda uv: np.column_stack([np.full(8, np.inf), uv[:, 1]]), Refusal.NO_EVIDENCE),
    ],
    ids=["mirrored", "two exchanged", "order", "anywhere", "tiny", "nan", "outside", "infinite"],
)
def test_points_that_no_pose_explains_are_refused(change, why):
    """A look-alike's points are not where a pose of the target would put them."""
    camera = rig("none")
    answer = on_points(change(pixels_of(PANEL, POSE, camera)), camera)
    if why is None:
        assert error(answer, POSE)[2] < chi2.ppf(0.999, 6)
        assert answer.ellipse_points == 6
    else:
        assert answer in (why, Refusal.BEHIND_CAMERA)


def test_points_on_a_line_are_refused():
    """Of all those that are seen no tilt about their line can be told."""
    target = panel(4)
    places = ((-0.18, 0.17), (-0.05, 0.17), (0.05, 0.17), (0.17, 0.17), (0.0, -0.18))
    points = tuple(BoardPoint(f"p{k}", y, z) for k, (y, z) in enumerate(places))
    target = replace(target, points=points)
    camera = rig()
    uv = pixels_of(target, POSE, camera)
    assert check(on_points(uv, camera, target))
    uv[4] = np.nan
    assert on_points(uv, camera, target) is Refusal.NO_EVIDENCE


def test_too_flat_a_view_is_refused():
    """As by the other method."""
    camera = rig("none")
    pose = facing_pose([0.0, 0.0, 0.8], math.radians(78), 0.3)
    assert on_points(pixels_of(PANEL, pose, camera), camera) is Refusal.GRAZING


def test_a_depth_in_another_unit_is_refused_and_a_small_contradiction_widens():
    """15 % apart is a blunder; 6 % past all errors is said and spanned."""
    camera = rig()
    uv = pixels_of(PANEL, POSE, camera)
    units = render_depth(PANEL, camera, POSE, None, np.random.default_rng(0), **STEREO)
    assert on_points(uv, camera, depth=units // 2) is Refusal.INCONSISTENT
    wide = on_points(uv, camera, depth=(units * 1.06).astype(np.uint16))
    assert check(wide).depth_contradicts
    assert error(wide, POSE)[0] < 1e-6
    assert math.sqrt(wide.covariance[2, 2]) > 0.05


def test_a_lens_without_an_inverse_there_is_refused():
    """A strong lens folds back: where its points lie is not known."""
    color = CameraIntrinsics(
        320, 240, 300.0, 300.0, 161.0, 119.0, "brown_conrady", (-4.0, 0.0, 0.0, 0.0, 0.0)
    )
    camera = replace(rig(), color=color)
    uv = pixels_of(PANEL, POSE, rig("none"))
    assert on_points(uv - [80, 40], camera) is Refusal.BAD_INTRINSICS


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"color_rgb": np.zeros((240, 320), np.uint8)}, Refusal.BAD_INPUT),
        ({"color_rgb": np.zeros((240, 320, 3), np.float32)}, Refusal.BAD_INPUT),
        ({"depth_units": np.zeros((240, 320), np.uint16)}, Refusal.BAD_INPUT),
        ({"up_camera": np.zeros(4)}, Refusal.BAD_INPUT),
        ({"candidate": Candidate({}, 0.9)}, Refusal.BAD_BOX),
        (
            {"candidate": Candidate({Level.GOOD: Box(math.nan, 0, 9, 9, 0.9)}, 0.9)},
            Refusal.BAD_BOX,
        ),
        (
            {"candidate": Candidate({Level.GOOD: Box(10, 10, 90, 90, 0.9)}, 0.9)},
            Refusal.NO_EVIDENCE,
        ),
        (
            {
                "candidate": Candidate({Level.GOOD: Box(10, 10, 15, 14, 0.9)}, 0.9),
                "target": BULLSEYE,
            },
            Refusal.TOO_SMALL,
        ),
    ],
)
def test_input_that_cannot_be_is_refused(change, why):
    """Shapes, types and boxes, before anything is computed."""
    camera = rig()
    given_input = {
        "color_rgb": BLANK,
        "depth_units": None,
        "camera": camera,
        "candidate": candidate_of(PANEL, pixels_of(PANEL, POSE, camera)),
        "target": PANEL,
        "up_camera": None,
    }
    assert localise_pnp(**(given_input | change)) is why


ANYTHING = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=150)
@given(
    st.lists(st.tuples(ANYTHING | st.floats(0, 320), ANYTHING | st.floats(0, 240), ANYTHING),
             min_size=8, max_size=8),
    st.sampled_from(MODELS),
    st.sampled_from([None, 0, 1, 900, 65535]),
    st.lists(ANYTHING, min_size=3, max_size=3),
)  # fmt: skip
def test_whatever_a_net_gives_nothing_is_raised(points, model, units, up):
    """Any numbers for points: a pose with a covariance, or a reason."""
    camera = rig(model)
    named = {p.name: PointPx(*seen) for p, seen in zip(PANEL.points, points, strict=True)}
    candidate = Candidate({Level.GOOD: Box(100.0, 60.0, 220.0, 180.0, 0.9)}, 0.9, named)
    depth = None if units is None else np.full((180, 240), units, np.uint16)
    answer = localise_pnp(BLANK, depth, camera, candidate, PANEL, np.array(up))
    if not isinstance(answer, Refusal):
        check(answer)


@settings(max_examples=60)
@given(
    st.lists(st.floats(-50, 370) | ANYTHING, min_size=12, max_size=12),
    st.integers(0, 3),
    st.sampled_from([None, 0, 900]),
)
def test_whatever_boxes_and_picture_nothing_is_raised(sides, kind, units):
    """Boxes anywhere on noise, on black, on a half of the bullseye."""
    camera = rig()
    rng = np.random.default_rng(kind)
    picture = rng.integers(0, 255, BLANK.shape, dtype=np.uint8) if kind else 0 * BLANK
    if kind == 2:
        picture = render_color(BULLSEYE, camera.color, POSE, Look(supersample=2))
        picture[:, 160:] = 0
    boxes = {lv: Box(*sides[4 * k : 4 * k + 4], 0.9) for k, lv in enumerate(Level)}
    depth = None if units is None else np.full((180, 240), units, np.uint16)
    answer = localise_pnp(picture, depth, camera, Candidate(boxes, 0.9), BULLSEYE)
    if not isinstance(answer, Refusal):
        check(answer)


# the bullseye


BULLSEYE_POSES = [
    POSE,
    facing_pose([-0.2, 0.15, 1.5], 0.05, 0.0, -0.2),
    facing_pose([0.3, 0.1, 2.2], 0.8, 3.0, 0.3),
]


def bullseye_frame(pose, camera, seed=0, **look):
    rng = np.random.default_rng(seed)
    color = render_color(
        BULLSEYE, camera.color, pose, Look(**({"noise": 1.5, "supersample": 4} | look)), rng
    )
    return color, render_depth(BULLSEYE, camera, pose, None, rng, **STEREO)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("pose", BULLSEYE_POSES)
def test_a_boards_corners_give_the_pose(pose, model):
    """With depth and without, through either lens model; the roll by the edges."""
    camera = rig(model)
    color, units = bullseye_frame(pose, camera)
    candidate = bullseye_candidate(pose, camera)
    for depth in (units, None):
        found = localise_pnp(color, depth, camera, candidate, BULLSEYE)
        position, normal, distance2 = error(found, pose)
        assert found.roll_source is RollSource.EDGES
        assert position < 8e-3 * pose.translation[2]
        assert normal < math.radians(1.5)
        assert distance2 < chi2.ppf(0.999, 6)


@pytest.mark.parametrize("wall", [60.0, 250.0])
def test_the_wall_may_be_darker_than_the_board_or_lighter(wall):
    """Which of the two, each side says itself."""
    camera = rig()
    color, _ = bullseye_frame(POSE, camera, wall=wall)
    found = localise_pnp(color, None, camera, bullseye_candidate(POSE, camera), BULLSEYE)
    assert found.roll_source is RollSource.EDGES
    assert error(found, POSE)[2] < chi2.ppf(0.999, 6)


def test_the_corners_covariance_is_that_of_their_errors():
    """Chi-square of the eight coordinates, but for what is believed of cameras and not drawn here.

    Those are the shift to the dark side and what a JPEG does to a whole line.
    """
    camera, places = rig("none"), corner_places(BULLSEYE.board_side_m)
    focal = np.array([camera.color.fx, camera.color.fy])
    rng = np.random.default_rng(0)
    distances = []
    for k in range(30):
        pose = facing_pose([0.1, 0.0, 1.3], rng.uniform(0, 0.8), rng.uniform(0, 6), rng.normal())
        color, _ = bullseye_frame(pose, camera, k, noise=4.0, supersample=3, jpeg_quality=80)
        start = Pose.from_rotation(
            rotation_from_vector(rng.normal(0, 0.01, 3)) @ pose.rotation,
            pose.translation * rng.normal(1, 0.005),
        )
        corners = measure_corners(color[..., 0], camera.color, start, BULLSEYE)
        true = pose @ np.column_stack([np.zeros(4), places])
        miss = (corners.pixels - true[:, :2] / true[:, 2:] * focal).ravel()
        distances.append(miss @ np.linalg.solve(corners.covariance, miss))
    assert 2 < np.mean(distances) < 9
    assert np.quantile(distances, 0.9) < chi2.ppf(0.95, 8)


def test_a_covered_corner_or_a_cut_board_leaves_the_boxes_and_an_honest_covariance():
    """Bearing and range of the discs' boxes, the normal of the depth."""
    camera = rig()
    color, units = bullseye_frame(POSE, camera)
    corner = seen_pixels(POSE @ np.array([[0.0, 0.2, 0.2]]), camera.color)[0].astype(int)
    color[corner[1] - 30 : corner[1] + 90, corner[0] - 20 : corner[0] + 25] = 120
    candidate = bullseye_candidate(POSE, camera)
    for depth, limit_rad in ((units, math.radians(2)), (None, math.radians(90))):
        found = localise_pnp(color, depth, camera, candidate, BULLSEYE)
        position, normal, distance2 = error(found, POSE)
        assert found.roll_source is RollSource.ASSUMED
        assert normal < limit_rad
        assert position < 0.1
        assert distance2 < chi2.ppf(0.999, 6)
    up = -np.array([0.0, 1.0, 0.0])
    found = localise_pnp(color, units, camera, candidate, BULLSEYE, up)
    assert found.roll_source is RollSource.GRAVITY


def test_boxes_alone_claim_no_tilt():
    """A disc's box is alike for four tilts and more: the board is taken to face the camera."""
    camera = rig("none")
    for azimuth in np.linspace(0, 6, 7):
        pose = facing_pose([0.15, -0.1, 1.2], 0.9, azimuth)
        candidate = bullseye_candidate(pose, camera)
        found = localise_pnp(0 * BLANK, None, camera, candidate, BULLSEYE, pose.rotation[:, 2])
        position, _, distance2 = error(found, pose)
        assert position < 0.3
        assert distance2 < chi2.ppf(0.999, 6)
        normal = found.camera_from_target.rotation[:, 0]
        line = -found.camera_from_target.translation / np.linalg.norm(
            found.camera_from_target.translation
        )
        assert normal @ line > math.cos(0.1)
        across = np.cross(normal, [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        assert math.sqrt(across @ found.covariance[3:, 3:] @ across) > math.radians(30)


def test_boxes_of_a_flat_view_do_not_take_the_wall_for_the_board():
    """Seen from 68 degrees a disc's box is narrow: only the depth in its ellipse is the board's."""
    camera = rig("none")
    for azimuth in (0.0, 0.7, 3.0):
        pose = facing_pose([-0.5, 0.2, 1.4], math.radians(68), azimuth)
        units = render_depth(BULLSEYE, camera, pose, None, np.random.default_rng(1), **STEREO)
        candidate = bullseye_candidate(pose, camera)
        found = localise_pnp(0 * BLANK, units, camera, candidate, BULLSEYE, pose.rotation[:, 2])
        position, normal, distance2 = error(found, pose)
        assert position < 0.1
        assert normal < math.radians(4)
        assert distance2 < chi2.ppf(0.999, 6)


def test_a_black_picture_still_has_the_boxes_and_the_depth():
    """As the other method's last rungs."""
    camera = rig()
    _, units = bullseye_frame(POSE, camera)
    found = localise_pnp(0 * BLANK, units, camera, bullseye_candidate(POSE, camera), BULLSEYE)
    assert error(found, POSE)[2] < chi2.ppf(0.999, 6)
    assert found.plane_inliers > 30


@given(st.floats(0, 1.2), st.floats(0, 6.28), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2))
def test_boxes_touch_their_discs_where_the_outline_is_sampled_to_be(tilt, azimuth, x, y):
    """Against the extremes of 361 points of each outline; derivatives by finite differences."""
    camera = rig("none")
    pose = facing_pose([x, y, 1.2], tilt, azimuth)
    candidate = bullseye_candidate(pose, camera, jitter_px=0.0)
    measured = measure_boxes(candidate, BULLSEYE, camera.color)
    predicted = measured.predict(pose.translation, pose.rotation, 0.0)
    assert predicted.values == pytest.approx(measured.values, abs=0.02)
    h = 1e-6
    for k in range(7):
        d = np.zeros(7)
        d[k] = h
        ends = [
            measured.predict(
                pose.translation + s * d[:3],
                rotation_from_vector(s * d[3:6]) @ pose.rotation,
                s * d[6],
            ).values
            for s in (1, -1)
        ]
        numeric = (ends[0] - ends[1]) / (2 * h)
        assert predicted.jacobian[:, k] == pytest.approx(numeric, rel=1e-4, abs=2e-2)


def test_boxes_cut_by_the_border_count_with_their_whole_sides():
    """Three sides are a bearing and a size; two are too few."""
    camera = rig("none")
    pose = facing_pose([-0.45, 0.0, 1.0], 0.2, 0.5)
    candidate = bullseye_candidate(pose, camera, levels=(Level.BETTER,), jitter_px=0.0)
    whole = measure_boxes(candidate, BULLSEYE, camera.color)
    assert len(whole.values) == 3
    box = candidate.boxes[Level.BETTER]
    tall = {Level.BETTER: replace(box, y0=-5.0)}
    assert measure_boxes(Candidate(tall, 0.9), BULLSEYE, camera.color) is None


def test_a_bullseye_with_points_uses_them_where_the_net_gives_them():
    """Labelled points first; without them the corners of the same file's board."""
    target = replace(BULLSEYE, points=PANEL.points)
    camera = rig()
    color, units = bullseye_frame(POSE, camera)
    boxes = bullseye_candidate(POSE, camera)
    points = candidate_of(PANEL, pixels_of(PANEL, POSE, camera)).points
    for candidate, source in (
        (replace(boxes, points=points), RollSource.POINTS),
        (boxes, RollSource.EDGES),
    ):
        found = localise_pnp(color, units, camera, candidate, target)
        assert found.roll_source is source
        assert error(found, POSE)[2] < chi2.ppf(0.999, 6)
