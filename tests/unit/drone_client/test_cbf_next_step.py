"""The command held for a whole period: what it must reach, and how it is made to."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drone_client.cbf import Funnel, Hold, build, checked, solve

FUNNEL, PERIOD_S, V_MAX = Funnel(), 0.02, 0.4
speeds = st.floats(-1, 1)
velocities = st.tuples(speeds, speeds, speeds)
wide = st.tuples(st.floats(-0.05, 3), st.floats(-1, 1), st.floats(-1, 1))
tight = st.tuples(st.floats(-0.05, 0.2), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
holds = st.builds(
    lambda p, delta, growth, alpha: Hold(FUNNEL, p, delta, delta + growth, alpha, PERIOD_S),
    wide | tight,
    st.floats(0, 0.03),
    st.sampled_from([0.0, 0.01 * PERIOD_S]),
    st.floats(0.5, 2.5),
)


def filtered(u_nominal, hold: Hold):
    """What the half-space alone makes of a nominal velocity."""
    rate = (hold.delta_next_m - hold.delta_m) / hold.period_s
    return solve(u_nominal, build(FUNNEL, hold.p_target, hold.delta_m, rate, hold.alpha), V_MAX).u


@given(holds, velocities)
def test_the_end_of_the_period_is_as_safe_as_required(hold, u_nominal) -> None:
    """h(p + T u) >= (1 - alpha T) h(p), or what full speed straight out would reach."""
    u, _ = checked(filtered(u_nominal, hold), hold, V_MAX)
    p_next = tuple(np.array(hold.p_target) + PERIOD_S * np.array(u))
    h_next = FUNNEL.h(p_next, hold.delta_next_m)
    decayed = (1 - hold.alpha * PERIOD_S) * FUNNEL.h(hold.p_target, hold.delta_m)
    full_speed = FUNNEL.h(hold.p_target, hold.delta_next_m) + PERIOD_S * V_MAX
    assert h_next >= min(decayed, full_speed) - 2e-9
    assert math.hypot(*u) <= V_MAX + 1e-12


@given(holds.filter(lambda hold: hold.delta_next_m == hold.delta_m), velocities)
def test_inside_the_funnel_one_step_stays_inside(hold, u_nominal) -> None:
    """With a steady error ball h >= 0 now means h >= 0 at the end of the period."""
    if FUNNEL.h(hold.p_target, hold.delta_m) < 0:
        return
    u, _ = checked(filtered(u_nominal, hold), hold, V_MAX)
    assert hold.h_next(u) >= -2e-9


@given(holds, velocities)
def test_the_check_never_adds_approach(hold, u_nominal) -> None:
    """The result closes in no faster than what went in."""
    u_before = filtered(u_nominal, hold)
    u, _ = checked(u_before, hold, V_MAX)
    assert u[0] >= min(u_before[0], 0.0) - 1e-15


@given(holds)
def test_the_straight_retreat_is_exact(hold) -> None:
    """It reaches what is required to the last digit, and is no faster than that needs."""
    retreat = hold.retreat(V_MAX)
    assert retreat[1:] == (0.0, 0.0)
    assert 0.0 <= retreat[0] <= V_MAX
    gap = hold.h_next(retreat) - hold.h_required(V_MAX)
    assert gap >= -1e-12
    assert gap <= 1e-12 or retreat[0] == 0.0


def test_a_held_command_does_break_the_condition_without_the_check() -> None:
    """The half-space is linear and the funnel is not: crossing the axis costs what it hides."""
    hold = Hold(FUNNEL, (-0.05, 0.005, 0.0), 0.0, 0.0, 1.2, PERIOD_S)
    u = filtered((0.0, -0.4, 0.4), hold)
    assert hold.h_next(u) < hold.h_required(V_MAX)
    corrected, halvings = checked(u, hold, V_MAX)
    assert halvings > 0
    assert hold.h_next(corrected) >= hold.h_required(V_MAX) - 1e-9


@given(st.floats(-0.2, 3), st.floats(0, 0.03), st.floats(0.5, 2.5))
def test_a_good_command_is_left_alone(x, delta, alpha) -> None:
    """Moving along x is exact, so the check changes nothing there, even on the very edge."""
    hold = Hold(FUNNEL, (x, 0.0, 0.0), delta, delta, alpha, PERIOD_S)
    u = filtered((-1.0, 0.0, 0.0), hold)
    assert checked(u, hold, V_MAX) == (u, 0)


def test_outside_the_funnel_halving_alone_would_slow_the_recovery() -> None:
    """A recovery that overshoots the axis turns into a straight retreat, not into a stop."""
    hold = Hold(FUNNEL, (-0.32, 0.0015, 0.0), 0.0, 0.0, 1.2, PERIOD_S)
    assert FUNNEL.h(hold.p_target) < 0
    u = (0.0, -0.4, 0.0)
    assert hold.h_next(tuple(0.5**8 * c for c in u)) < hold.h_required(V_MAX)
    corrected, halvings = checked(u, hold, V_MAX)
    assert halvings > 0
    assert corrected[0] > 0
    assert hold.h_next(corrected) >= hold.h_required(V_MAX) - 1e-9
