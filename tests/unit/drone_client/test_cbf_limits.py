"""How fast the tip may close in, and the schedule of the class-K gain."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.cbf import FilterSettings, alpha, closing_limit_mps, limit_outside_mps

SETTINGS = FilterSettings()


@given(st.floats(-1, 5), st.floats(-1, 5))
def test_nearer_is_never_faster(x1, x2) -> None:
    """The closing speed grows with the distance, is never negative, and zero at full depth."""
    near, far = (closing_limit_mps(x, 0.08, 0.3, 0.04) for x in sorted((x1, x2)))
    assert 0.0 <= near <= far
    assert closing_limit_mps(-0.04, 0.08, 0.3, 0.04) == pytest.approx(0.0, abs=1e-15)
    assert closing_limit_mps(-1.0, 0.08, 0.3, 0.04) == 0.0


def test_the_touch_is_gentle() -> None:
    """At the board's plane the limit is the touch speed, from both sides."""
    assert closing_limit_mps(0.0, 0.08, 0.3, 0.04) == 0.08
    assert closing_limit_mps(-1e-12, 0.08, 0.3, 0.04) == pytest.approx(0.08)


@given(st.floats(0.01, 3))
def test_constant_braking_follows_the_profile(x) -> None:
    """A tip that brakes at the given rate from the limit arrives at the touch speed."""
    v0, touch, brake = closing_limit_mps(x, 0.08, 0.3, 0.04), 0.08, 0.3
    seconds = (v0 - touch) / brake
    assert v0 * seconds - 0.5 * brake * seconds**2 == pytest.approx(x, rel=1e-9)


@given(st.floats(0, 0.5), st.floats(-1, 3), st.floats(-2, 2))
def test_outside_the_funnel_the_limit_only_falls(limit, nearest, h) -> None:
    """Inside it is untouched; ``outside_m`` outside nothing is left; then it is a retreat's."""
    limited = limit_outside_mps(limit, nearest, h, SETTINGS)
    assert -SETTINGS.retreat_mps <= limited <= limit
    if h >= 0.0:
        assert limited == limit
    if h <= -SETTINGS.outside_m:
        assert limited <= 0.0
        if nearest >= SETTINGS.clear_m:
            assert limited == 0.0
    further = limit_outside_mps(limit, nearest, h - 0.01, SETTINGS)
    assert further <= limited + 1e-15


def test_far_outside_and_at_the_board_it_backs_off_like_a_retreat() -> None:
    """And never faster than the vehicle may fly."""
    assert limit_outside_mps(0.1, 0.0, -1.0, SETTINGS) == -SETTINGS.retreat_mps
    slow = FilterSettings(v_max_mps=0.1)
    assert limit_outside_mps(0.1, 0.0, -1.0, slow) == -0.1


def test_a_tip_at_the_limit_never_passes_full_depth() -> None:
    """Driven as fast as the profile lets it, at 50 Hz, it creeps up to the depth and stays."""
    x = 0.5
    for _ in range(2_000):
        x_next = x - 0.02 * min(0.4, closing_limit_mps(x, 0.08, 0.3, 0.04))
        assert x_next <= x
        x = x_next
    assert x == pytest.approx(-0.04, abs=1e-6)
    assert x >= -0.04


@pytest.mark.parametrize("lag_s", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("start_m", [0.05, 0.3, 3.0])
def test_a_vehicle_that_follows_late_still_touches_gently(lag_s, start_m) -> None:
    """Told to close in as fast as allowed, a vehicle with a lag is no faster than the profile."""
    period_s, x, v = 0.02, start_m, 0.0
    follow = 1.0 - math.exp(-period_s / lag_s)
    while x > 0.0:
        v += follow * (min(1.0, closing_limit_mps(x, 0.08, 0.1, 0.04, lag_s + period_s)) - v)
        x -= period_s * v
        assert v <= math.sqrt(0.08**2 + 0.2 * max(x, 0.0)) + 1e-12
    for _ in range(2_000):
        v += follow * (closing_limit_mps(x, 0.08, 0.1, 0.04, lag_s + period_s) - v)
        x -= period_s * v
        assert x >= -0.042  # being late, it passes what it creeps up to by a millimetre


def test_alpha_is_small_near_and_large_far() -> None:
    """1.2 within half a metre of the target, 2.5 past a metre, in any direction."""
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        assert alpha(tuple(0.5 * direction), SETTINGS) == 1.2
        assert alpha(tuple(1.0 * direction), SETTINGS) == 2.5
        assert alpha(tuple(9.0 * direction), SETTINGS) == 2.5
        assert alpha((0.0, 0.0, 0.0), SETTINGS) == 1.2


def test_alpha_grows_smoothly() -> None:
    """It never falls with the distance, and neither it nor its slope jumps."""
    distances = np.linspace(0, 2, 2_001)
    values = np.array([alpha((float(d), 0.0, 0.0), SETTINGS) for d in distances])
    slopes = np.diff(values) / np.diff(distances)
    assert (slopes >= 0).all()
    assert np.abs(np.diff(slopes)).max() < 0.05
    assert all(a <= b for a, b in itertools.pairwise(values))
