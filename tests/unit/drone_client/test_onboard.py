"""One look on board: the window, the measurement, the judgement against the edge's last word."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from drone_client.onboard import (
    GATE_CHI2,
    Look,
    LookVerdict,
    Prediction,
    distance2,
    judge,
    look,
    predict,
)
from drone_client.target import (
    USUAL_BUDGET,
    Source,
    TargetMeasurement,
    Update,
    measure,
    update,
)
from rgbd_wire.geometry import Pose
from target_pose.localisation import Localisation, Method, Refusal, RollSource
from target_pose.target import Disc, Level
from tests.unit.drone_client import onboard_world as world
from tests.unit.drone_client.builders import MS, SECOND, pose, poses, rotation_of

LATER_NS = world.T0_NS + 350 * MS
SHOWN = world.picture()
seeds = st.integers(0, 2**32 - 1)


def prediction(anchor=None, newest=None, world_from_camera=world.WORLD_FROM_CAMERA, t_ns=LATER_NS):
    """The window of a frame a third of a second after the edge's last word."""
    anchor = anchor or world.edge_estimate()
    return predict(anchor, newest or anchor, world_from_camera, t_ns, world.CAMERA, world.TARGET)


def looked(frame, *steps) -> Look:
    """A look at a frame; the edge believed the target ``steps`` off."""
    believed = world.WORLD_FROM_TARGET
    for step in steps:
        believed = world.perturbed(believed, step)
    planned = prediction(world.edge_estimate(world_from_target=believed))
    assert isinstance(planned, Prediction)
    return look(frame, planned, world.TARGET)


def measured(world_from_target: Pose, t_ns: int = LATER_NS, covariance=world.COVARIANCE):
    return TargetMeasurement(world_from_target, covariance, t_ns, 1.5)


def test_the_gate_is_chi_square_with_five_degrees_of_freedom():
    """SciPy's 99.9 % point."""
    assert chi2.ppf(0.999, 5) == pytest.approx(GATE_CHI2, abs=0.01)


@given(poses, seeds)
def test_the_distance_is_what_numbers_drawn_from_the_covariance_say(at, seed):
    """Of small errors in position and tilt it is chi-square's own sum of squares."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) * 1e-3
    spread = root @ root.T + 1e-7 * np.eye(6)
    step = np.linalg.cholesky(spread) @ rng.normal(size=6)
    got = distance2(world.perturbed(at, step), at, spread)
    normal = at.rotation[:, 0]
    # an independent way: marginal over the turn about the normal, by dropping it from a basis
    basis = np.linalg.svd(np.eye(3) - np.outer(normal, normal))[0][:, :2]
    pick = np.zeros((5, 6))
    pick[:3, :3], pick[3:, 3:] = np.eye(3), basis.T
    error = pick @ step
    expected = error @ np.linalg.inv(pick @ spread @ pick.T) @ error
    assert got == pytest.approx(expected, rel=2e-2, abs=1e-6)


@given(poses, st.floats(-3, 3))
def test_a_turn_about_the_normal_is_no_distance(at, turn):
    """Circles do not show it."""
    turned = at @ pose((0, 0, 0), (turn, 0, 0))
    assert distance2(turned, at, 1e-4 * np.eye(6)) == pytest.approx(0, abs=1e-6)


@given(poses)
def test_the_back_of_the_board_is_infinitely_far(at):
    """A normal that points the other way is no small error, however wide the covariance."""
    back = at @ pose((0, 0, 0), (0, 0, np.pi))
    assert distance2(back, at, 100 * np.eye(6)) == np.inf


@pytest.mark.parametrize("bad", [np.zeros((6, 6)), np.full((6, 6), np.nan), -np.eye(6)])
def test_what_is_no_covariance_lets_nothing_through(bad):
    """Singular, NaN, negative: never below the gate, never an exception."""
    moved = world.perturbed(world.WORLD_FROM_TARGET, [0.01, 0, 0, 0, 0.01, 0])
    assert distance2(moved, world.WORLD_FROM_TARGET, bad) == np.inf


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e12])
def test_a_look_that_knows_nothing_is_not_judged_at_all(value):
    """The gate around it would be as wide as the world."""
    m = measured(world.WORLD_FROM_TARGET, covariance=np.diag([value] * 6))
    assert judge(m, world.edge_estimate(), world.TARGET).verdict is LookVerdict.TOO_UNSURE


@given(seeds, st.integers(0, 4 * SECOND))
def test_an_accepted_look_is_the_edges_word_fused_with_it_and_widened_by_what_nobody_confirmed(
    seed, dt_ns
):
    """The pose of one Kalman step on the edge's estimate; the variances grow by drift squared."""
    rng = np.random.default_rng(seed)
    step = rng.normal(size=6) * np.repeat([1e-3, 2e-3], 3)
    anchor = world.edge_estimate()
    m = measured(world.perturbed(world.WORLD_FROM_TARGET, step), world.T0_NS + dt_ns)
    got = judge(m, anchor, world.TARGET)
    assert got.verdict is LookVerdict.ACCEPTED
    fused, done = update(anchor, m)
    assert done is Update.FUSED
    np.testing.assert_allclose(
        got.estimate.world_from_target.matrix, fused.world_from_target.matrix
    )
    growth = (
        np.repeat([USUAL_BUDGET.drift_mps, USUAL_BUDGET.drift_radps], 3) * dt_ns / SECOND
    ) ** 2
    np.testing.assert_allclose(np.diag(got.estimate.covariance), np.diag(fused.covariance) + growth)
    assert got.estimate.source is Source.ONBOARD
    assert got.estimate.t_confirmed_ns == world.T0_NS
    assert got.estimate.t_capture_ns == m.t_capture_ns
    assert got.estimate.unconfirmed_ns(m.t_capture_ns) == dt_ns
    assert got.estimate.seen_sigma_m == pytest.approx(fused.sigma_m, rel=1e-6)


@pytest.mark.parametrize(("looked", "told"), [(0, 1), (1, 0)])
def test_a_look_in_another_world_than_the_edges_word_is_not_believed(looked, told):
    """The odometry jumped between the two: that they agree in numbers means nothing."""
    m = replace(measured(world.WORLD_FROM_TARGET, world.T0_NS + 50 * MS), epoch=looked)
    got = judge(m, replace(world.edge_estimate(), epoch=told), world.TARGET)
    assert got.verdict is LookVerdict.OFF_PREDICTION
    assert got.estimate is None


@given(st.floats(0.03, 2), st.integers(0, 1 * SECOND), st.sampled_from(range(3)))
def test_what_is_further_off_than_drift_explains_is_refused(off_m, dt_ns, axis):
    """3 cm within a second is more than 1 cm/s of drift and millimetres of noise."""
    step = np.zeros(6)
    step[axis] = off_m
    m = measured(world.perturbed(world.WORLD_FROM_TARGET, step), world.T0_NS + dt_ns)
    got = judge(m, world.edge_estimate(), world.TARGET)
    reach = np.sqrt(
        GATE_CHI2 * (2 * world.COVARIANCE[0, 0] + (USUAL_BUDGET.drift_mps * dt_ns / 1e9) ** 2)
    )
    expected = LookVerdict.OFF_PREDICTION if off_m > reach + 1e-9 else LookVerdict.ACCEPTED
    assert got.verdict is expected
    assert (got.estimate is None) is (expected is not LookVerdict.ACCEPTED)


def test_many_small_steps_lead_nowhere():
    """Each look is held against the edge's word: a thing that creeps away is lost, not followed."""
    anchor, verdicts = world.edge_estimate(), []
    for i in range(50):
        dt_ns = 350 * MS + i * 33 * MS
        crept = world.perturbed(world.WORLD_FROM_TARGET, [0, 0.06 * dt_ns / 1e9, 0, 0, 0, 0])
        verdicts.append(judge(measured(crept, world.T0_NS + dt_ns), anchor, world.TARGET).verdict)
    assert verdicts[-1] is LookVerdict.OFF_PREDICTION
    assert LookVerdict.ACCEPTED not in verdicts[verdicts.index(LookVerdict.OFF_PREDICTION) :]


@given(st.integers(0, 60 * SECOND), st.floats(0, 0.5))
def test_the_gate_never_reaches_a_discs_diameter(dt_ns, sigma_m):
    """Another print of this size has its centre further away than that: it cannot get in."""
    covariance = np.diag([sigma_m**2 + 1e-8] * 3 + [1e-4] * 3)
    beside = world.perturbed(world.WORLD_FROM_TARGET, [0, 0.30, 0, 0, 0, 0])
    m = measured(beside, world.T0_NS + dt_ns, covariance)
    assert judge(m, world.edge_estimate(), world.TARGET).verdict is not LookVerdict.ACCEPTED


def test_a_turn_about_the_normal_that_the_board_does_not_make_is_refused():
    """Position and normal fit, the board's edges do not."""
    turned = world.WORLD_FROM_TARGET @ pose((0, 0, 0), (0.5, 0, 0))
    got = judge(measured(turned), world.edge_estimate(), world.TARGET)
    assert (got.verdict, got.detail) == (LookVerdict.OFF_PREDICTION, "roll")


def test_the_window_lies_where_the_drones_own_motion_puts_it():
    """The camera went aside and turned: boxes around the true place, by OpenCV's own projection."""
    moved = world.WORLD_FROM_CAMERA @ pose((0.2, -0.1, 0.4), (0.05, -0.1, 0.02))
    planned = prediction(world_from_camera=moved)
    expected = (moved.inverse() @ world.WORLD_FROM_TARGET).translation
    u = world.LENS.fx * expected[0] / expected[2] + world.LENS.cx
    v = world.LENS.fy * expected[1] / expected[2] + world.LENS.cy
    assert set(planned.candidate.boxes) == set(Level)
    for box in planned.candidate.boxes.values():
        np.testing.assert_allclose(box.center_px, (u, v), atol=0.05 * max(box.size_px))


def test_the_window_follows_the_newest_pose_and_the_judgement_the_edges():
    """Drift does not lead out of the window, and nothing leads away from the edge's word."""
    anchor = world.edge_estimate()
    newest = world.edge_estimate(
        world_from_target=world.perturbed(world.WORLD_FROM_TARGET, [0, 0.02, 0, 0, 0, 0])
    )
    here, there = prediction(anchor), prediction(anchor, newest)
    shift = np.subtract(
        there.candidate.boxes[Level.BETTER].center_px, here.candidate.boxes[Level.BETTER].center_px
    )
    assert np.hypot(*shift) == pytest.approx(world.LENS.fx * 0.02 / 1.5, rel=0.1)
    assert there.anchor is anchor


@pytest.mark.parametrize(
    ("step", "why"),
    [
        ((0, 0, 3, 0, 0, 0), "past the board"),
        ((0, 0, 0, 0, np.pi, 0), "looking away"),
        ((0, 0, 0, 0, 0.9, 0), "out of the picture"),
        ((0, 0, 1.49, 0, 0, 0), "at the board"),
    ],
)
def test_a_target_that_cannot_be_seen_is_not_looked_for(step, why):
    """Behind the camera, beside the picture, or so near that nothing is ahead."""
    away = world.WORLD_FROM_CAMERA @ pose(step[:3], step[3:])
    assert prediction(world_from_camera=away) is LookVerdict.OUT_OF_VIEW, why


def test_a_target_of_a_few_pixels_is_not_looked_for():
    """Nothing can be told from it."""
    far = world.WORLD_FROM_CAMERA @ pose((0, 0, -25))
    anchor = world.edge_estimate()
    got = predict(anchor, anchor, far, LATER_NS, world.CAMERA, world.TARGET)
    assert got in (LookVerdict.OUT_OF_VIEW, LookVerdict.TOO_UNSURE)


@pytest.mark.parametrize("sigma_m", [0.1, 1e3, np.inf, np.nan])
def test_an_edge_that_knew_next_to_nothing_gives_no_window(sigma_m):
    """The gate around it would hold more than the target."""
    unsure = world.edge_estimate(covariance=np.diag([sigma_m**2] * 3 + [1e-4] * 3))
    assert prediction(unsure) is LookVerdict.TOO_UNSURE


def test_a_look_finds_the_target_where_it_is():
    """Within millimetres and tenths of a degree, with the rings right on nearly all rays."""
    got = looked(SHOWN, [0.004, -0.004, 0.003, 0.003, 0.002, 0.002])
    assert got.verdict is LookVerdict.ACCEPTED
    assert got.localisation.method is Method.FUSED
    assert got.shades_share > 0.9
    found = world.WORLD_FROM_CAMERA.inverse() @ got.estimate.world_from_target
    assert np.linalg.norm(found.translation - world.SEEN.translation) < 0.006
    assert found.rotation[:, 0] @ world.SEEN.rotation[:, 0] > np.cos(np.radians(0.8))


def test_a_look_without_depth_is_judged_by_its_circles():
    """The range comes from the disc's size."""
    got = looked(world.picture(depth=False))
    assert got.verdict in (LookVerdict.ACCEPTED, LookVerdict.AMBIGUOUS)
    assert got.localisation.method is Method.ELLIPSE


def test_a_target_that_moved_is_seen_and_not_believed():
    """12 cm beside where the edge saw it: the circles are there, the gate says no."""
    aside = Pose(world.SEEN.translation + [0.12, 0, 0], world.SEEN.q_wxyz)
    got = looked(world.picture(aside))
    assert got.verdict in (LookVerdict.OFF_PREDICTION, LookVerdict.REFUSED, LookVerdict.NO_CIRCLE)
    assert got.estimate is None


@pytest.mark.parametrize("depth", [True, False])
def test_a_black_picture_shows_nothing(depth):
    """What the box alone would give is the prediction again, and no measurement."""
    frame = world.picture(depth=depth)
    black = replace(frame, color_rgb=np.zeros_like(frame.color_rgb))
    got = looked(black)
    assert got.verdict in (LookVerdict.NO_CIRCLE, LookVerdict.REFUSED)
    assert got.estimate is None


@pytest.mark.parametrize(
    "diameters",
    [(0.30, 0.21, 0.12), (0.30, 0.10, 0.04), (0.30, 0.24)],
    ids=["wide", "narrow", "no dot"],
)
def test_other_rings_in_the_very_place_of_the_target_are_refused(diameters):
    """The outer disc is the same, so that circles, range and place fit; the shades do not."""
    shades = [d.shade for d in world.TARGET.discs]
    discs = tuple(Disc(d, s) for d, s in zip(diameters, shades, strict=False))
    got = looked(world.picture(target=replace(world.TARGET, discs=discs)))
    assert got.verdict is not LookVerdict.ACCEPTED
    assert got.estimate is None


def test_a_print_of_another_size_in_the_same_direction_is_refused():
    """Half the size at half the distance looks alike; the depth knows better."""
    near = Pose(world.SEEN.translation * 0.5, world.SEEN.q_wxyz)
    half = replace(
        world.TARGET,
        board_side_m=world.TARGET.board_side_m / 2,
        discs=tuple(Disc(d.diameter_m / 2, d.shade) for d in world.TARGET.discs),
    )
    got = looked(world.picture(near, target=half))
    assert got.verdict in (LookVerdict.REFUSED, LookVerdict.DEPTH_CONTRADICTS)
    assert got.estimate is None


def localisation(**changes) -> Localisation:
    """What a localiser might say."""
    plain = Localisation(
        world.SEEN, np.eye(6) * 1e-6, Method.FUSED, RollSource.EDGES, range_ellipse_m=1.5
    )
    return replace(plain, **changes)


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (Refusal.GRAZING, LookVerdict.REFUSED),
        (localisation(method=Method.BOX), LookVerdict.NO_CIRCLE),
        (localisation(method=Method.DEPTH), LookVerdict.NO_CIRCLE),
        (localisation(ambiguous=True), LookVerdict.AMBIGUOUS),
        (localisation(range_plane_m=1.6), LookVerdict.DEPTH_CONTRADICTS),
        (localisation(range_plane_m=float("nan")), LookVerdict.DEPTH_CONTRADICTS),
        (localisation(covariance=np.full((6, 6), 1e6)), LookVerdict.TOO_UNSURE),
        (localisation(covariance=np.full((6, 6), np.nan)), LookVerdict.TOO_UNSURE),
        (localisation(), LookVerdict.ACCEPTED),
    ],
)
def test_what_proves_nothing_has_a_reason(monkeypatch, found, verdict):
    """The weak rungs of the localiser's ladder are none for somebody who starts from a memory."""
    monkeypatch.setattr("drone_client.onboard.localise", lambda *_: found)
    assert looked(SHOWN).verdict is verdict


@given(
    seeds,
    st.sampled_from(["noise", "stripes", "white", "other rings", "torn"]),
    st.sampled_from(["none", "noise", "far", "true"]),
)
@settings(max_examples=20)
def test_whatever_a_camera_sends_a_look_has_a_verdict_and_no_exception(seed, color, depth):
    """Noise, stripes, glare, a picture torn apart; any depth. What is accepted is the target."""
    rng = np.random.default_rng(seed)
    frame = SHOWN
    rgb = frame.color_rgb.copy()
    if color == "noise":
        rgb = rng.integers(0, 256, rgb.shape, dtype=np.uint8)
    elif color == "stripes":
        rgb[..., :] = (np.arange(640) % rng.integers(2, 40) * 9 % 256)[None, :, None]
    elif color == "white":
        rgb[:] = 255
    elif color == "other rings":
        r = np.hypot(*np.meshgrid(np.arange(640) - 340, np.arange(480) - 230))
        rgb[:] = ((r // rng.uniform(4, 40)).astype(int) % 2 * 200 + 20)[..., None]
    else:
        rgb = np.roll(rgb, int(rng.integers(30, 600)), axis=1)
    units = {
        "none": None,
        "noise": rng.integers(0, 65536, (240, 320), dtype=np.uint16),
        "far": np.full((240, 320), 65535, np.uint16),
        "true": frame.depth_units,
    }[depth]
    step = rng.normal(0, 1, 6) * [0.01, 0.01, 0.01, 0.01, 0.01, 0.01]
    got = looked(replace(frame, color_rgb=rgb, depth_units=units), step)
    assert got.verdict is not LookVerdict.ACCEPTED
    assert got.estimate is None


def test_measure_and_judge_work_on_world_poses_of_any_orientation():
    """The same look in another world frame has the same distance."""
    anchor = world.edge_estimate()
    m = measure(world.WORLD_FROM_CAMERA, world.SEEN, np.eye(6) * 1e-5, LATER_NS)
    here = judge(m, anchor, world.TARGET)
    other = pose((3, -2, 1), (0.3, -0.4, 1.0))
    big = np.kron(np.eye(2), rotation_of(other).as_matrix())
    moved_anchor = replace(
        anchor,
        world_from_target=other @ anchor.world_from_target,
        covariance=big @ anchor.covariance @ big.T,
    )
    there = judge(
        measure(other @ world.WORLD_FROM_CAMERA, world.SEEN, np.eye(6) * 1e-5, LATER_NS),
        moved_anchor,
        world.TARGET,
    )
    assert there.distance2 == pytest.approx(here.distance2, rel=1e-6, abs=1e-9)
