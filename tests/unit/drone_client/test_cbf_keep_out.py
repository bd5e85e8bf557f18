"""Propellers and body stay clear of walls, floor and ceiling, whatever the mission wants."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_client.cbf import (
    BodyPart,
    FilterInput,
    FilterSettings,
    Freshness,
    Funnel,
    KeepOut,
    PlaneFrame,
    Stance,
    Status,
    error_ball_m,
    filter_command,
    gaps_m,
    half_spaces,
)
from drone_client.cbf.keep_out import MAX_KEEP_OUTS, is_rotation
from rgbd_wire.geometry import rotation_from_vector

MS = 1_000_000
SETTINGS = FilterSettings()
UP = (0.0, 0.0, 1.0)
FACING = rotation_from_vector(np.array([0.0, 0.0, math.pi]))  # the body looks at the board
ARM_BODY = np.array([0.55, 0.0, 0.0])
PROPELLERS = tuple(BodyPart((x, y, 0.06), 0.19, UP) for x in (-0.2, 0.2) for y in (-0.2, 0.2))
BODY = (*PROPELLERS, BodyPart((0.0, 0.0, 0.0), 0.15))
WALL = KeepOut("wall", BODY, clearance_m=0.05)
FLOOR = KeepOut("floor", BODY, normal=UP, offset_m=-0.8, frame=PlaneFrame.WORLD)
CEILING = KeepOut("ceiling", BODY, normal=(0.0, 0.0, -1.0), offset_m=-0.8, frame=PlaneFrame.WORLD)
BEHIND = KeepOut("behind", BODY, normal=(-1.0, 0.0, 0.0), offset_m=-1.6)


def rows(rotation) -> tuple:
    return tuple(tuple(row) for row in np.asarray(rotation).tolist())


def vec(v) -> tuple:
    return tuple(np.asarray(v, dtype=float).tolist())


def state(tip, keep_outs, wish=(0.0, 0.0, 0.0), rotation=FACING, **changes) -> FilterInput:
    return dataclasses.replace(
        FilterInput(
            tip_target=vec(tip),
            velocity_tip_nominal_target=vec(wish),
            yaw_rate_nominal_radps=0.0,
            lever_arm_target=vec(rotation @ ARM_BODY),
            up_target=UP,
            age_ns=100 * MS,
            range_m=max(0.43, tip[0] + 0.43),
            sigma_m=0.0005,
            keep_outs=keep_outs,
            target_from_body=rows(rotation),
        ),
        **changes,
    )


def stance_of(inp: FilterInput) -> Stance:
    return Stance(
        inp.tip_target,
        inp.lever_arm_target,
        inp.up_target,
        inp.target_from_body,
        inp.target_from_world,
        inp.world_origin_target,
    )


def moved_on(inp: FilterInput, command, seconds: float) -> FilterInput:
    """The rigid body after it has flown a command exactly, its turn included."""
    rotation = np.array(inp.target_from_body)
    body = np.array(inp.tip_target) - np.array(inp.lever_arm_target)
    body = body + seconds * np.array(command.velocity_body_target)
    rotation = (
        rotation_from_vector(seconds * command.yaw_rate_radps * np.array(inp.up_target)) @ rotation
    )
    arm = rotation @ ARM_BODY
    return dataclasses.replace(
        inp, tip_target=vec(body + arm), lever_arm_target=vec(arm), target_from_body=rows(rotation)
    )


def least_gap(inp: FilterInput, delta_m: float) -> float:
    return min(min(gaps_m(k, stance_of(inp), delta_m)) for k in inp.keep_outs)


angles = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-4, 4))
units = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(
    lambda v: math.hypot(*v) > 0.1
)


@given(angles, units, st.floats(0, 0.5), st.tuples(*[st.floats(-1, 1)] * 3))
def test_the_gap_is_that_of_the_nearest_point_of_a_part(angle, normal, radius, center) -> None:
    """Of the points on a tilted disc's rim, or on a ball, the nearest to the plane decides."""
    normal = vec(np.array(normal) / np.linalg.norm(normal))
    rotation = rotation_from_vector(np.array(angle))
    inp = state((0.6, 0.1, 0.0), (), rotation=rotation)
    body = np.array(inp.tip_target) - np.array(inp.lever_arm_target)
    turn = np.linspace(0, 2 * math.pi, 2001)
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1) * radius + np.array(center)
    for part, lowest in (
        (BodyPart(center, radius, UP), (rotation @ rim.T).T @ np.array(normal)),
        (BodyPart(center, radius), (rotation @ np.array(center)) @ np.array(normal) - radius),
    ):
        keep_out = KeepOut("x", (part,), normal, offset_m=-0.3, clearance_m=0.02)
        (gap,) = gaps_m(keep_out, stance_of(inp), 0.01)
        expected = body @ np.array(normal) + np.min(lowest) + 0.3 - 0.02 - 0.01
        assert gap == pytest.approx(expected, abs=1e-5)


@given(angles, angles, st.tuples(*[st.floats(-2, 2)] * 3), units)
def test_a_plane_of_the_world_is_where_the_world_is(angle, world_angle, origin, normal) -> None:
    """Said in the world or in the target's frame, one plane has one gap, but for the error ball."""
    normal = np.array(normal) / np.linalg.norm(normal)
    rotation = rotation_from_vector(np.array(world_angle))
    inp = state(
        (0.6, 0.1, 0.0),
        (),
        rotation=rotation_from_vector(np.array(angle)),
        target_from_world=rows(rotation),
        world_origin_target=vec(origin),
    )
    in_world = KeepOut("w", BODY, vec(normal), 0.4, PlaneFrame.WORLD)
    turned = rotation @ normal
    in_target = KeepOut("t", BODY, vec(turned / np.linalg.norm(turned)), 0.4 + turned @ origin)
    np.testing.assert_allclose(
        gaps_m(in_world, stance_of(inp), 0.02), np.array(gaps_m(in_target, stance_of(inp), 0.0))
    )


@settings(max_examples=300)
@given(
    st.tuples(st.floats(0.05, 1.0), st.floats(-0.5, 0.5), st.floats(-0.4, 0.4)),
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.5, 0.5)),
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.floats(-2, 2),
    st.sampled_from([100, 290, 400, 1000, 3000]),
)
def test_what_holds_at_the_start_of_a_period_holds_at_its_end(
    tip, lean, wish, yaw_rate, age_ms
) -> None:
    """The rigid body, turned and moved for a period, is as clear as (1 - alpha T) of now."""
    rotation = rotation_from_vector(np.array([lean[0], lean[1], 0.0])) @ FACING
    rotation = rotation_from_vector(np.array([0.0, 0.0, lean[2]])) @ rotation
    keep_outs = (WALL, FLOOR, CEILING)
    inp = state(tip, keep_outs, wish, rotation, yaw_rate_nominal_radps=yaw_rate, age_ns=age_ms * MS)
    command = filter_command(inp, SETTINGS)
    before = least_gap(inp, command.delta_m)
    if before < 0:
        return
    after = moved_on(inp, command, SETTINGS.period_s)
    later_ns = inp.age_ns + round(SETTINGS.period_s * 1e9)
    delta_later = error_ball_m(later_ns, inp.range_m, inp.sigma_m, SETTINGS)
    # A tilted disc that turns reaches a little further: second order in the tilt, under 0.1 mm.
    slack = 1e-6 + 1e-4 * abs(command.yaw_rate_radps)
    for keep_out in keep_outs:
        for now, then in zip(
            gaps_m(keep_out, stance_of(inp), command.delta_m),
            gaps_m(keep_out, stance_of(after), delta_later),
            strict=True,
        ):
            assert then >= (1 - keep_out.alpha * SETTINGS.period_s) * now - slack


@pytest.mark.parametrize("pitch_rad", [0.0, 0.25])
def test_pressed_by_the_tip_the_propellers_keep_their_distance(pitch_rad) -> None:
    """With an arm of 0.55 m contact leaves room; one that is too short is not pressed home."""
    lean = rotation_from_vector(np.array([0.0, pitch_rad, 0.0]))
    inp = state((-0.02, 0.0, 0.0), (WALL,), (-0.03, 0.0, 0.0), rotation=FACING @ lean)
    command = filter_command(inp, SETTINGS)
    assert command == filter_command(dataclasses.replace(inp, keep_outs=()), SETTINGS)
    assert command.velocity_body_target[0] < 0

    short = 0.43  # the front propellers reach 0.39 m
    shortened = dataclasses.replace(
        inp, lever_arm_target=vec(FACING @ lean @ ARM_BODY * short / 0.55)
    )
    command = filter_command(shortened, SETTINGS)
    assert command.status is Status.ACTIVE
    assert command.velocity_body_target[0] > 0


def test_a_lean_towards_the_wall_counts() -> None:
    """What is clear in level flight may not be when the body pitches: the attitude is looked at."""
    high = KeepOut("wall", (BodyPart((0.3, 0.0, 0.4), 0.0),))
    level = state((0.1, 0.0, 0.0), (high,))
    pitched = state(
        (0.1, 0.0, 0.0), (high,), rotation=FACING @ rotation_from_vector(np.array([0, 0.5, 0]))
    )
    (clear,) = gaps_m(high, stance_of(level), 0.0)
    (closer,) = gaps_m(high, stance_of(pitched), 0.0)
    assert clear - closer > 0.05


def test_a_turn_that_swings_a_propeller_into_the_wall_is_made_up_for() -> None:
    """The body moves out as a propeller turns towards the wall, or does not turn."""
    tip = (0.02, 0.0, 0.0)
    near = dataclasses.replace(WALL, clearance_m=0.166)
    inp = state(tip, (near,), yaw_rate_nominal_radps=0.4)
    command = filter_command(inp, SETTINGS)
    after = moved_on(inp, command, SETTINGS.period_s)
    assert least_gap(after, command.delta_m) >= least_gap(inp, command.delta_m) * 0.98 - 1e-6
    assert command.yaw_rate_radps > 0
    assert command.velocity_body_target[0] > 0.01

    blocked = dataclasses.replace(BEHIND, offset_m=-(0.02 + 0.55 + 0.39 + 0.1 + 0.0101))
    stuck = filter_command(dataclasses.replace(inp, keep_outs=(near, blocked)), SETTINGS)
    assert stuck.yaw_rate_radps == 0.0


@pytest.mark.parametrize(("age_ms", "phase"), [(400, "hold"), (1000, "brake"), (3000, "retreat")])
def test_a_retreat_ends_at_the_wall_behind(age_ms, phase) -> None:
    """Blind in a narrow tunnel, the way out ends where the propellers would meet its other side."""
    behind = dataclasses.replace(BEHIND, offset_m=-1.3)
    inp = state((0.1, 0.0, 0.0), (WALL, behind), age_ns=age_ms * MS)
    for _ in range(1500):
        command = filter_command(inp, SETTINGS)
        assert command.freshness is Freshness(phase)
        assert command.velocity_body_target[0] >= 0
        inp = moved_on(inp, command, SETTINGS.period_s)
    gap = min(gaps_m(behind, stance_of(inp), command.delta_m))
    assert gap >= -1e-9
    if phase == "retreat":
        assert gap < 0.02  # what the ball, which grows, is given
        assert inp.tip_target[0] < SETTINGS.standoff_m


@pytest.mark.parametrize("age_ms", [100, 400, 1000, 3000])
def test_too_low_it_rises_in_every_phase(age_ms) -> None:
    """Inside a floor's clearance the drone leaves it, also while it retreats, and never turns."""
    inp = state((0.6, 0.0, -0.5), (WALL, FLOOR), age_ns=age_ms * MS, yaw_rate_nominal_radps=0.3)
    low = state((0.6, 0.0, -0.75), (FLOOR,), age_ns=age_ms * MS)
    assert least_gap(low, 0.0) < 0 < least_gap(inp, 0.05)
    assert filter_command(low, SETTINGS).velocity_body_target[2] > 0.05
    assert filter_command(inp, SETTINGS).velocity_body_target[2] >= -0.1


def test_an_abort_backs_off_but_not_into_the_ceiling() -> None:
    """Behind the board and too high: out, and down."""
    inp = state((-0.05, 0.3, 0.65), (FLOOR, CEILING))
    command = filter_command(inp, SETTINGS)
    assert command.status is Status.ABORT
    assert command.velocity_body_target[0] > 0.1
    assert command.velocity_body_target[2] < -0.02
    assert math.hypot(*command.velocity_body_target) <= SETTINGS.retreat_mps + 1e-12


def test_blind_between_two_walls_neither_is_met() -> None:
    """A gap that is too narrow for both clearances: it stays in the middle, and says what it is."""
    behind = dataclasses.replace(BEHIND, offset_m=-1.0)
    wall = dataclasses.replace(WALL, clearance_m=0.15)
    inp = state((0.2, 0.0, 0.0), (wall, behind), age_ns=3000 * MS)
    for _ in range(1000):
        inp = moved_on(inp, filter_command(inp, SETTINGS), SETTINGS.period_s)
    front, back = (min(gaps_m(k, stance_of(inp), 0.0)) for k in (wall, behind))
    assert front == pytest.approx(back, abs=0.02)
    assert front > -0.1


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32))
def test_a_body_that_is_clear_stays_clear(seed) -> None:
    """Hostile wishes in a room of five planes for 4 s: no part ever loses its clearance."""
    rng = np.random.default_rng(seed)
    side = KeepOut("side", BODY, (0.0, 1.0, 0.0), -0.9)
    keep_outs = (WALL, FLOOR, CEILING, side, BEHIND)
    inp = state(vec(rng.uniform((0.1, -0.1, -0.3), (0.3, 0.3, 0.3))), keep_outs)
    for tick in range(200):
        if tick % 25 == 0:
            wish, rate = vec(rng.normal(size=3) * 0.4), float(rng.normal())
        inp = dataclasses.replace(
            inp, velocity_tip_nominal_target=wish, yaw_rate_nominal_radps=rate
        )
        command = filter_command(inp, SETTINGS)
        assert math.hypot(*command.velocity_body_target) <= SETTINGS.v_max_mps + 1e-12
        if command.h_robust >= 0:
            assert command.status in (Status.INACTIVE, Status.ACTIVE)
        assert least_gap(inp, command.delta_m) >= -1e-6
        inp = moved_on(inp, command, SETTINGS.period_s)


@settings(max_examples=200)
@given(
    st.tuples(st.floats(0, 1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    st.tuples(*[st.floats(-1, 1)] * 3),
)
def test_far_planes_change_nothing(tip, wish) -> None:
    """With every plane out of reach the command is the one without, to the bit."""
    far = (
        dataclasses.replace(FLOOR, offset_m=-50.0),
        dataclasses.replace(CEILING, offset_m=-50.0),
    )
    with_planes = filter_command(state(tip, far, wish), SETTINGS)
    without = filter_command(state(tip, (), wish), SETTINGS)
    assert with_planes == without


def test_the_funnel_and_a_plane_behind_leave_what_both_allow() -> None:
    """Outside the funnel with no way out the tip still moves to the axis, within the plane."""
    behind = dataclasses.replace(BEHIND, offset_m=-(0.3 + 0.55 + 0.39 + 0.1 + 0.02))
    inp = state((0.3, 0.3, 0.0), (behind,))
    command = filter_command(inp, SETTINGS)
    assert Funnel().h(inp.tip_target) < 0
    assert command.status is Status.MAX_HDOT
    assert command.velocity_body_target[1] < -0.3
    assert abs(command.velocity_body_target[0]) < 0.02


@settings(max_examples=300)
@given(
    st.tuples(st.floats(0, 0.3), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02)),
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.floats(0, 0.05),
)
def test_beside_planes_less_than_required_is_said(tip, wish, room) -> None:
    """With a plane close behind, the end of the period is as required or the status MAX_HDOT."""
    behind = dataclasses.replace(BEHIND, offset_m=-(tip[0] + 0.55 + 0.39 + 0.1 + 0.013 + room))
    inp = state(tip, (WALL, behind), wish)
    command = filter_command(inp, SETTINGS)
    if command.status in (Status.MAX_HDOT, Status.ABORT):
        return
    after = moved_on(inp, command, SETTINGS.period_s)
    h_next = Funnel().h(after.tip_target, command.delta_m)
    alpha = SETTINGS.alpha_near
    decayed = (1 - alpha * SETTINGS.period_s) * command.h_robust
    assert h_next >= min(decayed, command.h_robust + 0.4 * SETTINGS.period_s) - 1e-6


BROKEN = [math.nan, math.inf, 10**400, 1e300]


@pytest.mark.parametrize("bad", BROKEN)
@pytest.mark.parametrize("name", ["target_from_body", "target_from_world", "world_origin_target"])
def test_a_body_that_is_nowhere_does_not_move(name, bad) -> None:
    """An attitude or a world that is no number is ABORT, as any other input is."""
    good = getattr(state((0.5, 0, 0), ()), name)
    value = (bad, *good[1:]) if name.startswith("world") else ((bad, 0.0, 0.0), *good[1:])
    command = filter_command(state((0.5, 0, 0), (WALL,), **{name: value}), SETTINGS)
    assert command.status is Status.ABORT
    assert command.velocity_body_target == (0.0, 0.0, 0.0)


def test_too_many_planes_are_an_abort() -> None:
    """The problem is bounded: more planes than that are a mistake, and no reason to be slow."""
    command = filter_command(state((0.5, 0, 0), (WALL,) * (MAX_KEEP_OUTS + 1)), SETTINGS)
    assert command.status is Status.ABORT


@given(angles)
def test_a_rotation_is_told_from_a_reflection(angle) -> None:
    """Rows of a rotation are one; mirrored or scaled ones are none."""
    rotation = rotation_from_vector(np.array(angle))
    assert is_rotation(rows(rotation), 0.01)
    assert not is_rotation(rows(-rotation), 0.01)
    assert not is_rotation(rows(1.1 * rotation), 0.01)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"parts": ()}, "0 parts"),
        ({"parts": BODY * 7}, "35 parts"),
        ({"normal": (1.0, 1.0, 0.0)}, "unit length"),
        ({"normal": (math.nan, 0.0, 0.0)}, "unit length"),
        ({"offset_m": math.inf}, "offset_m"),
        ({"clearance_m": -0.1}, "clearance_m"),
        ({"uncertainty_m": math.nan}, "uncertainty_m"),
        ({"alpha": 0.0}, "alpha"),
    ],
)
def test_an_impossible_plane_is_refused(changes, message) -> None:
    """Each bound has its message, with the name of the plane."""
    with pytest.raises(ValueError, match=rf"'wall'.*{message}"):
        dataclasses.replace(WALL, **changes)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (((9.0, 0.0, 0.0), 0.1), "center_body"),
        (((0.0, 0.0, 0.0), -0.1), "radius_m"),
        (((0.0, 0.0, 0.0), 0.1, (0.0, 0.0, 2.0)), "axis_body"),
    ],
)
def test_an_impossible_part_is_refused(values, message) -> None:
    """A part further out than any drone, a negative radius or an axis without unit length."""
    with pytest.raises(ValueError, match=message):
        BodyPart(*values)


def test_a_turn_adds_its_arc() -> None:
    """The half-space of a turning body counts the arc of each part over the period."""
    part = BodyPart((0.3, 0.0, 0.0), 0.0)
    stance = stance_of(state((0.5, 0.0, 0.0), ()))
    (still,) = half_spaces((KeepOut("w", (part,)),), stance, 0.0, 0.0, 0.0, 0.02)
    (turning,) = half_spaces((KeepOut("w", (part,)),), stance, 0.0, 0.0, 1.0, 0.02)
    assert turning.offset - still.offset == pytest.approx(0.5 * 0.02 * 0.3, abs=1e-9)
