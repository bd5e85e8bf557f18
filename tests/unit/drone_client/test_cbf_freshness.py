"""Age of knowledge: phases, error ball, and what a link that goes silent makes the drone do."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.cbf import (
    FilterInput,
    FilterSettings,
    Freshness,
    SafeCommand,
    Status,
    error_ball_m,
    filter_command,
    freshness,
)

SETTINGS = FilterSettings()
MS = 1_000_000
PHASES = [Freshness.FRESH, Freshness.HOLD, Freshness.BRAKE, Freshness.RETREAT]


@pytest.mark.parametrize(
    ("age_ns", "phase"),
    [
        (0, Freshness.FRESH),
        (300 * MS, Freshness.FRESH),
        (300 * MS + 1, Freshness.HOLD),
        (600 * MS, Freshness.HOLD),
        (600 * MS + 1, Freshness.BRAKE),
        (1500 * MS, Freshness.BRAKE),
        (1500 * MS + 1, Freshness.RETREAT),
        (10**400, Freshness.RETREAT),
    ],
)
def test_the_phases_have_exact_edges(age_ns, phase) -> None:
    """Each limit is the last nanosecond of its phase."""
    assert freshness(age_ns, SETTINGS) is phase


@given(st.integers(0, 10**12), st.integers(0, 10**12))
def test_older_is_never_fresher(age1, age2) -> None:
    """The phase only goes one way with the age."""
    younger, older = (PHASES.index(freshness(a, SETTINGS)) for a in sorted((age1, age2)))
    assert younger <= older


@pytest.mark.parametrize("age", [-1, -(10**400), math.nan, -math.inf])
def test_an_impossible_age_brakes(age) -> None:
    """A negative age or NaN is a broken clock; the drone stops."""
    assert freshness(age, SETTINGS) is Freshness.BRAKE


def test_the_error_ball_is_the_sum_of_its_parts() -> None:
    """5 mm, 1 % of the range, two standard deviations and 1 cm/s of drift."""
    ball = error_ball_m(500 * MS, 2.0, 0.003, SETTINGS)
    assert ball == pytest.approx(0.005 + 0.020 + 0.006 + 0.005)


def test_the_error_ball_is_steady_while_knowledge_is_fresh() -> None:
    """Anything fresh counts as old as fresh may be, so no result makes the ball jump."""
    oldest = error_ball_m(300 * MS, 1.0, 0.001, SETTINGS)
    assert error_ball_m(0, 1.0, 0.001, SETTINGS) == oldest
    assert error_ball_m(299 * MS, 1.0, 0.001, SETTINGS) == oldest
    assert error_ball_m(301 * MS, 1.0, 0.001, SETTINGS) > oldest


def test_the_error_ball_grows_while_the_drone_alone_sees_the_target() -> None:
    """1 cm/s since the edge's last word, from age_max on: no jump where own eyes take over."""
    fresh = error_ball_m(100 * MS, 1.0, 0.001, SETTINGS)
    assert error_ball_m(100 * MS, 1.0, 0.001, SETTINGS, 300 * MS) == fresh
    for alone_ns in (301 * MS, 1300 * MS, 5300 * MS):
        grown = error_ball_m(100 * MS, 1.0, 0.001, SETTINGS, alone_ns) - fresh
        assert grown == pytest.approx(0.01 * (alone_ns - 300 * MS) / 1e9)
    faster = FilterSettings(unconfirmed_mps=0.05)
    assert error_ball_m(0, 1.0, 0.001, faster, 1300 * MS) == pytest.approx(fresh + 0.05)


@given(st.integers(0, 10**13), st.integers(0, 10**13), st.floats(0, 10), st.floats(0, 1))
def test_the_error_ball_never_shrinks_while_nobody_confirms(time1, time2, range_m, sigma_m) -> None:
    """Longer alone is never surer."""
    shorter, longer = sorted((time1, time2))
    small = error_ball_m(0, range_m, sigma_m, SETTINGS, shorter)
    assert small <= error_ball_m(0, range_m, sigma_m, SETTINGS, longer) < math.inf


@pytest.mark.parametrize("alone", [-1, math.nan, math.inf, 10**400, -(10**400)])
def test_the_error_ball_is_finite_for_any_time_alone(alone) -> None:
    """A broken clock makes no broken ball here either."""
    assert 0.005 < error_ball_m(0, 1.0, 0.001, SETTINGS, alone) < 20.0


def test_a_long_time_alone_turns_into_a_retreat_by_itself() -> None:
    """Poses stay fresh, and the tip still goes back from the board as the ball grows."""
    p, out = np.array([0.05, 0.0, 0.0]), []
    for tick in range(round(6.0 / SETTINGS.period_s)):
        inp = FilterInput(
            tip_target=tuple(p.tolist()),
            velocity_tip_nominal_target=(-0.2, 0.0, 0.0),
            yaw_rate_nominal_radps=0.0,
            lever_arm_target=(-0.55, 0.0, 0.0),
            up_target=(0.0, 0.0, 1.0),
            age_ns=60 * MS,
            range_m=0.45,
            sigma_m=0.0005,
            unconfirmed_ns=300 * MS + tick * 20 * MS,
        )
        safe = filter_command(inp, SETTINGS)
        assert safe.freshness is Freshness.FRESH
        p = p + np.array(safe.velocity_body_target) * SETTINGS.period_s
        out.append(float(p[0]))
        assert safe.h_robust >= -1e-3
    assert out[-1] > 0.3
    assert all(b >= a - 1e-9 for a, b in itertools.pairwise(out[100:]))


@given(st.integers(0, 10**13), st.integers(0, 10**13), st.floats(0, 10), st.floats(0, 1))
def test_the_error_ball_never_shrinks_with_age(age1, age2, range_m, sigma_m) -> None:
    """Older knowledge is never better knowledge."""
    younger, older = sorted((age1, age2))
    small = error_ball_m(younger, range_m, sigma_m, SETTINGS)
    assert small <= error_ball_m(older, range_m, sigma_m, SETTINGS) < math.inf


@pytest.mark.parametrize("age", [-1, math.nan, math.inf, 10**400, -(10**400)])
def test_the_error_ball_is_finite_for_any_age(age) -> None:
    """A broken clock makes no broken ball."""
    assert 0.005 < error_ball_m(age, 1.0, 0.001, SETTINGS) < 20.0


def silent_link(start, velocity, seconds: float) -> list[tuple[float, tuple, SafeCommand]]:
    """Fly a tip with an eager nominal velocity while no result comes any more."""
    p, ticks = np.array(start), []
    for tick in range(round(seconds / SETTINGS.period_s)):
        inp = FilterInput(
            tip_target=tuple(p.tolist()),
            velocity_tip_nominal_target=velocity,
            yaw_rate_nominal_radps=0.2,
            lever_arm_target=(-0.55, 0.0, 0.0),
            up_target=(0.0, 0.0, 1.0),
            age_ns=tick * 20 * MS,
            range_m=start[0] + 0.43,
            sigma_m=0.0005,
        )
        command = filter_command(inp, SETTINGS)
        ticks.append((float(p[0]), inp.tip_target, command))
        swing = command.yaw_rate_radps * np.array([0.0, -0.55, 0.0])
        p = p + SETTINGS.period_s * (np.array(command.velocity_body_target) + swing)
    return ticks


starts = st.tuples(st.floats(0.0, 1.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
wishes = st.tuples(st.floats(-1, 0.1), st.floats(-1, 1), st.floats(-1, 1))


@given(starts, wishes)
def test_a_silent_link_never_brings_the_tip_nearer(start, velocity) -> None:
    """From the first stale tick on x never falls, whatever the guidance wants."""
    ticks = silent_link(start, velocity, seconds=3.0)
    stale = [x for x, _, command in ticks if command.freshness is not Freshness.FRESH]
    assert all(after >= before - 1e-12 for before, after in itertools.pairwise(stale))


@given(starts, wishes)
def test_a_silent_link_is_always_said(start, velocity) -> None:
    """Every tick that is not fresh has the status STALE, or the graver ABORT."""
    for _, _, command in silent_link(start, velocity, seconds=2.0):
        if command.freshness is not Freshness.FRESH:
            assert command.status in (Status.STALE, Status.ABORT)


def test_a_silent_link_at_the_touch_ends_at_the_stand_off() -> None:
    """Pressed on the board when the link dies, the tip is 1 m away in 10 s, and stays there."""
    ticks = silent_link((-0.015, 0.0, 0.0), (-0.08, 0.0, 0.0), seconds=12.0)
    assert ticks[-1][0] == pytest.approx(SETTINGS.standoff_m, abs=1e-9)
    assert ticks[-1][2].velocity_body_target == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert ticks[round(10.0 / SETTINGS.period_s)][0] == pytest.approx(1.0, abs=1e-9)


def test_a_growing_ball_alone_already_backs_off_smoothly() -> None:
    """Before the retreat begins, hold and brake leave the board, no faster than a retreat."""
    ticks = silent_link((-0.015, 0.0, 0.0), (-0.08, 0.0, 0.0), seconds=1.5)
    speeds = [
        command.velocity_body_target[0]
        for _, _, command in ticks
        if command.freshness in (Freshness.HOLD, Freshness.BRAKE)
    ]
    assert 0.0 <= min(speeds) <= max(speeds) < SETTINGS.retreat_mps
    assert speeds[-1] > 0.05
    assert ticks[-1][0] > 0.0
    assert all(command.h_robust >= -1e-6 for _, _, command in ticks)


def test_brake_and_retreat_do_not_turn() -> None:
    """Blind, the drone keeps its heading and moves along x alone."""
    for _, _, command in silent_link((0.3, 0.05, 0.0), (-0.1, 0.3, 0.1), seconds=3.0):
        if command.freshness in (Freshness.BRAKE, Freshness.RETREAT):
            assert command.yaw_rate_radps == 0.0
            assert command.velocity_body_target[1:] == (0.0, 0.0)
