"""The whole filter: it always answers, within the limits, and never lets the tip out."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_client.cbf import (
    FilterInput,
    FilterSettings,
    Freshness,
    Funnel,
    SafeCommand,
    Status,
    Variant,
    build,
    closing_limit_mps,
    error_ball_m,
    filter_command,
    paper_funnel,
    solve,
)

SETTINGS = FilterSettings()
MS = 1_000_000
GOOD = FilterInput(
    tip_target=(0.5, 0.0, 0.0),
    velocity_tip_nominal_target=(-0.1, 0.0, 0.0),
    yaw_rate_nominal_radps=0.0,
    lever_arm_target=(-0.55, 0.0, 0.0),
    up_target=(0.0, 0.0, 1.0),
    age_ns=100 * MS,
    range_m=0.93,
    sigma_m=0.001,
)


def change(**changes) -> FilterInput:
    return dataclasses.replace(GOOD, **changes)


def tip_velocity(inp: FilterInput, command: SafeCommand) -> np.ndarray:
    """What the body's velocity and yaw rate make of the tip."""
    swing = np.cross(inp.up_target, inp.lever_arm_target)
    return np.array(command.velocity_body_target) + command.yaw_rate_radps * swing


def assert_within_limits(command: SafeCommand, limits: FilterSettings = SETTINGS) -> None:
    assert isinstance(command.status, Status)
    assert all(math.isfinite(c) for c in command.velocity_body_target)
    assert math.hypot(*command.velocity_body_target) <= limits.v_max_mps + 1e-12
    assert abs(command.yaw_rate_radps) <= limits.yaw_rate_max_radps


def test_a_safe_wish_passes_unchanged() -> None:
    """Well inside the funnel the nominal velocity is the command."""
    command = filter_command(GOOD, SETTINGS)
    assert command.status is Status.INACTIVE
    assert command.freshness is Freshness.FRESH
    assert command.velocity_body_target == (-0.1, 0.0, 0.0)
    assert command.delta_m == pytest.approx(0.005 + 0.0093 + 0.002 + 0.003)
    assert command.h == Funnel().h(GOOD.tip_target)
    assert command.h_robust == Funnel().h(GOOD.tip_target, command.delta_m)


def test_at_the_edge_the_wish_is_changed_as_little_as_needed() -> None:
    """Where the funnel limits the approach, dh/dt is -alpha h and not less."""
    inp = change(tip_target=(0.3, 0.04, 0.0), velocity_tip_nominal_target=(-0.2, 0.1, 0.0))
    command = filter_command(inp, SETTINGS)
    assert command.status is Status.ACTIVE
    slope = np.dot(Funnel().gradient(inp.tip_target, command.delta_m), tip_velocity(inp, command))
    assert slope == pytest.approx(-1.2 * command.h_robust)


def test_a_step_across_the_axis_counts_as_active() -> None:
    """What the half-space lets pass and the next-step check shortens is said to be changed."""
    inp = change(
        tip_target=(0.0, 0.0, 0.0),
        velocity_tip_nominal_target=(0.0, 0.4, 0.0),
        range_m=0.43,
        sigma_m=0.0,
    )
    command = filter_command(inp, SETTINGS)
    assert command.status is Status.ACTIVE
    assert command.velocity_body_target == (0.0, 0.4 / 8, 0.0)


def test_far_outside_the_way_back_is_the_steepest() -> None:
    """Where even full speed is not enough, full speed along the gradient."""
    inp = change(tip_target=(0.5, 1.0, 0.0), range_m=1.0)
    command = filter_command(inp, SETTINGS)
    gradient = np.array(Funnel().gradient(inp.tip_target, command.delta_m))
    assert command.status is Status.MAX_HDOT
    expected = 0.4 * gradient / np.linalg.norm(gradient)
    np.testing.assert_allclose(command.velocity_body_target, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("tip", "status"),
    [
        ((-0.01, 0.0, 0.0), Status.INACTIVE),  # pressing on the target, inside the mouth
        ((-0.041, 0.0, 0.0), Status.ABORT),  # deeper than the arm gives way
        ((-0.001, 0.025, 0.0), Status.ABORT),  # behind the board, beside the mouth
        ((-0.5, 0.3, -0.2), Status.ABORT),
        ((0.001, 0.3, 0.0), Status.MAX_HDOT),  # in front of the board: a recovery
    ],
)
def test_behind_the_board_is_an_abort_and_no_recovery(tip, status) -> None:
    """There the only way is straight out, without turning."""
    inp = change(
        tip_target=tip,
        velocity_tip_nominal_target=(0.0, 0.0, 0.0),
        yaw_rate_nominal_radps=0.3 if status is Status.ABORT else 0.0,
        range_m=0.43,
        sigma_m=0.0,
    )
    command = filter_command(inp, SETTINGS)
    assert command.status is status
    if status is Status.ABORT:
        assert command.velocity_body_target == (SETTINGS.retreat_mps, 0.0, 0.0)
        assert command.yaw_rate_radps == 0.0


BROKEN = [
    {name: tuple(bad if i == axis else c for i, c in enumerate(getattr(GOOD, name)))}
    for name in (
        "tip_target",
        "velocity_tip_nominal_target",
        "lever_arm_target",
        "up_target",
    )
    for axis in range(3)
    for bad in (math.nan, math.inf, -math.inf, 1e300, 10**400)
] + [
    {name: bad}
    for name in ("yaw_rate_nominal_radps", "range_m", "sigma_m")
    for bad in (math.nan, math.inf, -math.inf, 1e300, 10**400)
]


@pytest.mark.parametrize(
    "broken",
    [
        *BROKEN,
        {"range_m": -1.0},
        {"sigma_m": -1e-3},
        {"up_target": (0.0, 0.0, 0.0)},
        {"up_target": (0.0, 0.0, -0.5)},
    ],
)
@pytest.mark.parametrize("age_ns", [0, 10**12])
def test_without_numbers_there_is_no_motion(broken, age_ns) -> None:
    """Any input that is no number a drone can have is ABORT with zero velocity, stale or not."""
    command = filter_command(change(age_ns=age_ns, **broken), SETTINGS)
    assert command.status is Status.ABORT
    assert command.velocity_body_target == (0.0, 0.0, 0.0)
    assert command.yaw_rate_radps == 0.0
    assert math.isnan(command.h)
    assert math.isnan(command.h_robust)
    assert math.isnan(command.delta_m)


@pytest.mark.parametrize("age", [-1, math.nan, -math.inf, -(10**400)])
def test_a_broken_clock_stops(age) -> None:
    """An age that cannot be is STALE, and the drone stands."""
    command = filter_command(change(age_ns=age), SETTINGS)
    assert command.status is Status.STALE
    assert command.velocity_body_target == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("age", [math.inf, 10**400])
def test_an_endless_age_retreats(age) -> None:
    """An age without bound is old, and no reason to fail."""
    command = filter_command(change(age_ns=age), SETTINGS)
    assert command.status is Status.STALE
    assert command.velocity_body_target == (SETTINGS.retreat_mps, 0.0, 0.0)


anything = st.floats(allow_nan=True, allow_infinity=True)
plausible = st.floats(-2, 2)
numbers = anything | plausible
units = st.sampled_from([(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8), (1.0, 0.0, 0.0)])
inputs = st.builds(
    FilterInput,
    st.tuples(numbers, numbers, numbers) | st.tuples(plausible, st.just(0.0), st.just(0.0)),
    st.tuples(numbers, numbers, numbers),
    numbers,
    st.tuples(numbers, numbers, numbers),
    units | st.tuples(numbers, numbers, numbers),
    st.integers() | st.integers(0, 2_000 * MS),
    numbers | st.floats(0, 10),
    numbers | st.floats(0, 0.1),
)
limits = st.builds(
    FilterSettings,
    v_max_mps=st.sampled_from([0.0, 0.4, 2.0]),
    yaw_speed_share=st.sampled_from([0.0, 0.25, 0.5]),
    period_s=st.sampled_from([0.002, 0.02, 0.1]),
    drift_mps=st.sampled_from([0.0, 0.01, 0.1]),
    variant=st.sampled_from(list(Variant)),
    allow_unsafe_variant=st.just(True),
)


@settings(max_examples=500)
@given(inputs, limits)
def test_whatever_comes_in_a_command_within_the_limits_comes_out(inp, settings) -> None:
    """Never an exception, never NaN, never over a limit, never without a status."""
    assert_within_limits(filter_command(inp, settings), settings)


@given(
    st.floats(0.0, 0.5),
    st.floats(0.03, 0.3),
    st.floats(0.0, math.tau),
    st.tuples(*[st.floats(-1, 1)] * 3),
)
def test_beside_the_mouth_nothing_pays_for_an_approach(x, beside, around, wish) -> None:
    """Outside the funnel the tip does not close in, and near the board it leaves it."""
    place = (x, beside * math.cos(around), beside * math.sin(around))
    # The guidance never asks for more across than the vehicle may fly
    across = max(1.0, math.hypot(wish[1], wish[2]) / 0.3)
    wish = (wish[0], wish[1] / across, wish[2] / across)
    inp = change(tip_target=place, velocity_tip_nominal_target=wish, range_m=max(x, 0.3))
    command = filter_command(inp, SETTINGS)
    outside = command.h_robust <= -SETTINGS.outside_m
    closing = -tip_velocity(inp, command)[0]
    if outside:
        assert closing <= 1e-12
    if command.h_robust <= -2.0 * SETTINGS.outside_m and x <= command.delta_m:
        assert closing <= -0.5 * SETTINGS.retreat_mps


def test_a_hundred_thousand_random_states_get_a_safe_command() -> None:
    """Each is within the limits, meets the next-step condition and closes in slowly enough."""
    rng = np.random.default_rng(7)
    n, funnel, period = 100_000, SETTINGS.funnel, SETTINGS.period_s
    scale = rng.choice([1.0, 0.05], size=(n, 1))
    tips = rng.uniform((0, -1.5, -1.5), (3, 1.5, 1.5), size=(n, 3)) * scale
    wishes = rng.normal(size=(n, 3)) * rng.choice([0.05, 0.4, 3.0], size=(n, 1))
    yaw_rates, arms = rng.normal(size=n), rng.uniform(-0.8, 0.8, size=(n, 3))
    ranges, sigmas = rng.uniform(0.3, 4, size=n), rng.uniform(0, 0.005, size=n)
    worst, seen = 0.0, set()
    for i in range(n):
        inp = FilterInput(
            tuple(tips[i].tolist()),
            tuple(wishes[i].tolist()),
            float(yaw_rates[i]),
            tuple(arms[i].tolist()),
            (0.0, 0.0, 1.0),
            100 * MS,
            float(ranges[i]),
            float(sigmas[i]),
        )
        command = filter_command(inp, SETTINGS)
        seen.add(command.status)
        vx, vy, vz = command.velocity_body_target
        yaw_rate, (ax, ay, _) = command.yaw_rate_radps, inp.lever_arm_target
        assert vx * vx + vy * vy + vz * vz <= 0.4**2 + 1e-12
        assert abs(yaw_rate) <= SETTINGS.yaw_rate_max_radps
        tip = (vx - yaw_rate * ay, vy + yaw_rate * ax, vz)
        x, y, z = inp.tip_target
        assert tip[0] >= -closing_limit_mps(x - command.delta_m, 0.08, 0.1, 0.04, 0.32) - 1e-12
        after = (x + period * tip[0], y + period * tip[1], z + period * tip[2])
        if command.h_robust >= 0:
            worst = min(worst, funnel.h(after, command.delta_m))
    assert seen == {Status.INACTIVE, Status.ACTIVE, Status.MAX_HDOT}
    assert worst >= -2e-9


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.5, 1.0]))
def test_a_tip_that_starts_inside_never_leaves(seed, error) -> None:
    """Held at 50 Hz with hostile wishes and the estimate off by up to delta, h stays >= 0."""
    rng = np.random.default_rng(seed)
    funnel, ranges, sigma = SETTINGS.funnel, 0.5, 0.0005
    delta = error_ball_m(0, ranges, sigma, SETTINGS)
    offset = rng.normal(size=3)
    offset *= error * delta / np.linalg.norm(offset)
    while True:
        estimate = rng.uniform((0, -0.4, -0.4), (1.5, 0.4, 0.4)) * rng.choice([1, 0.2])
        if funnel.h(tuple(estimate), delta) >= 0:
            break
    wish = rng.normal(size=3) - np.array([1.0, 0.0, 0.0])
    for tick in range(250):
        if tick % 25 == 0:
            wish = rng.normal(size=3) - np.array([rng.choice([0.0, 1.0]), 0.0, 0.0])
        inp = change(
            tip_target=tuple(estimate.tolist()),
            velocity_tip_nominal_target=tuple(wish.tolist()),
            yaw_rate_nominal_radps=float(rng.normal()),
            lever_arm_target=tuple(rng.uniform(-0.6, 0.6, size=3).tolist()),
            range_m=ranges,
            sigma_m=sigma,
        )
        command = filter_command(inp, SETTINGS)
        assert command.status in (Status.INACTIVE, Status.ACTIVE)
        assert_within_limits(command)
        estimate = estimate + SETTINGS.period_s * tip_velocity(inp, command)
        assert funnel.h(tuple((estimate + offset).tolist())) >= -1e-6
        assert estimate[0] + offset[0] >= -SETTINGS.depth_max_m - 1e-9


@given(
    st.tuples(st.floats(0, 1), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8), st.floats(-0.8, 0.8)),
    st.floats(-3, 3),
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)),
)
def test_the_yaw_takes_only_the_speed_that_is_left(tip, arm, yaw_rate, wish) -> None:
    """With yaw as without, the tip meets the funnel's half-space wherever anything does."""
    inp = change(
        tip_target=tip,
        lever_arm_target=arm,
        yaw_rate_nominal_radps=yaw_rate,
        velocity_tip_nominal_target=wish,
    )
    turning = filter_command(inp, SETTINGS)
    straight = filter_command(change(tip_target=tip, velocity_tip_nominal_target=wish), SETTINGS)
    assert_within_limits(turning)
    assert turning.yaw_rate_radps * yaw_rate >= 0.0
    swing = abs(turning.yaw_rate_radps) * math.hypot(arm[0], arm[1])
    assert swing <= SETTINGS.yaw_speed_share * SETTINGS.v_max_mps + 1e-12
    assert (turning.status is Status.MAX_HDOT) == (straight.status is Status.MAX_HDOT)


def test_a_yaw_rate_without_a_lever_arm_costs_nothing() -> None:
    """A tip on the yaw axis does not swing, and the full rate is allowed."""
    inp = change(lever_arm_target=(0.0, 0.0, -0.4), yaw_rate_nominal_radps=9.0)
    command = filter_command(inp, SETTINGS)
    assert command.yaw_rate_radps == SETTINGS.yaw_rate_max_radps
    assert command.velocity_body_target == (-0.1, 0.0, 0.0)


def test_the_body_undoes_the_swing_of_the_tip() -> None:
    """Turning left with the arm towards the board swings the tip; the body moves against it."""
    inp = change(yaw_rate_nominal_radps=0.1)
    command = filter_command(inp, SETTINGS)
    assert command.yaw_rate_radps == 0.1
    # up x r = z x (-0.55, 0, 0) = (0, -0.55, 0): the tip swings to -y, the body goes to +y.
    assert command.velocity_body_target == pytest.approx((-0.1, 0.055, 0.0))


def test_no_yaw_where_the_funnel_needs_all_the_speed() -> None:
    """On the way back from far outside the drone does not turn."""
    inp = change(tip_target=(0.5, 1.0, 0.0), yaw_rate_nominal_radps=0.5)
    assert filter_command(inp, SETTINGS).yaw_rate_radps == 0.0


def test_a_hold_keeps_the_distance() -> None:
    """Past age_max_ns an approach becomes a sideways correction at most."""
    inp = change(velocity_tip_nominal_target=(-0.1, 0.05, 0.0), age_ns=400 * MS)
    command = filter_command(inp, SETTINGS)
    assert (command.status, command.freshness) == (Status.STALE, Freshness.HOLD)
    assert command.velocity_body_target == (0.0, 0.05, 0.0)


def test_a_growing_ball_is_in_the_constraint() -> None:
    """While knowledge ages, dh/dt counts the growth of delta, and u makes up for it."""
    inp = change(
        tip_target=(0.45, 0.07, 0.0),
        velocity_tip_nominal_target=(0.0, 0.0, 0.0),
        age_ns=400 * MS,
    )
    command = filter_command(inp, SETTINGS)
    funnel, delta, period = SETTINGS.funnel, command.delta_m, 1e-4
    gradient = np.array(funnel.gradient(inp.tip_target, delta))
    assert command.velocity_body_target[0] > 0
    assert np.cross(gradient, command.velocity_body_target) == pytest.approx(np.zeros(3), abs=1e-12)
    after = np.array(inp.tip_target) + period * tip_velocity(inp, command)
    slope = (
        funnel.h(tuple(after), delta + 0.01 * period) - funnel.h(inp.tip_target, delta)
    ) / period
    assert slope == pytest.approx(-1.2 * command.h_robust, abs=2e-3)


def test_blind_the_way_back_is_slow() -> None:
    """Far outside the funnel and past hold_ns, straight out at the retreat speed at most."""
    command = filter_command(change(tip_target=(0.5, 1.0, 0.0), age_ns=800 * MS), SETTINGS)
    assert (command.status, command.freshness) == (Status.STALE, Freshness.BRAKE)
    assert command.velocity_body_target == (SETTINGS.retreat_mps, 0.0, 0.0)


def test_an_unsafe_variant_flies_as_the_paper_has_it() -> None:
    """Its half-space and the limits, without the error ball and the next-step check."""
    printed = FilterSettings(variant=Variant.PAPER, allow_unsafe_variant=True)
    p, wish = (0.1, 0.0005, 0.0), (-0.1, 0.2, 0.0)
    inp = change(tip_target=p, velocity_tip_nominal_target=wish)
    expected = solve(wish, build(paper_funnel(), p, 0.0, 0.0, 1.2), 0.4).u
    assert filter_command(inp, printed).velocity_body_target == pytest.approx(expected, abs=1e-12)


def test_grounded_settings_do_not_move() -> None:
    """With v_max = 0 every state gets zero velocity and a status."""
    grounded = FilterSettings(v_max_mps=0.0)
    for tip in ((0.5, 0.0, 0.0), (0.5, 1.0, 0.0), (-1.0, 0.0, 0.0)):
        for age_ns in (0, 400 * MS, 1_000 * MS, 2_000 * MS):
            command = filter_command(change(tip_target=tip, age_ns=age_ns), grounded)
            assert command.velocity_body_target == (0.0, 0.0, 0.0)
