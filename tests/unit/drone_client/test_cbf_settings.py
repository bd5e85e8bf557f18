"""The filter's settings refuse what would make it no filter."""

from __future__ import annotations

import dataclasses
import math

import pytest

from drone_client.cbf import CuspFunnel, FilterSettings, Funnel, Variant, paper_funnel


def numeric_fields() -> list[str]:
    defaults = FilterSettings()
    return [
        field.name
        for field in dataclasses.fields(FilterSettings)
        if isinstance(getattr(defaults, field.name), float | int)
        and not isinstance(getattr(defaults, field.name), bool)
    ]


def test_the_defaults_are_the_start_values() -> None:
    """Those that the design fixes, in one place; docs/cbf.md says why the mouth is wider."""
    settings = FilterSettings()
    assert settings.funnel == Funnel(3.0, 0.003, 0.025)
    assert settings.variant is Variant.SMOOTH
    assert (settings.v_max_mps, settings.touch_mps) == (0.4, 0.08)
    assert (settings.alpha_near, settings.alpha_far, settings.near_m) == (1.2, 2.5, 0.5)
    assert (settings.delta_base_m, settings.delta_range_gain) == (0.005, 0.01)
    assert (settings.drift_mps, settings.hold_ns) == (0.01, 600_000_000)


@pytest.mark.parametrize("name", numeric_fields())
@pytest.mark.parametrize("value", [-1, 1e12, math.nan, math.inf])
def test_every_number_is_bounded(name, value) -> None:
    """No field takes a negative number, a huge one, infinity or NaN; the message names it."""
    with pytest.raises(ValueError, match=rf"^FilterSettings\.{name} = .* is not in \["):
        FilterSettings(**{name: value})


@pytest.mark.parametrize(
    ("smaller", "larger"),
    [
        ({"alpha_near": 3.0}, "alpha_far"),
        ({"near_m": 1.0}, "far_m"),
        ({"age_max_ns": 600_000_000}, "hold_ns"),
        ({"hold_ns": 1_500_000_000}, "retreat_ns"),
    ],
)
def test_what_must_be_in_order_is(smaller, larger) -> None:
    """Near before far, fresh before hold before retreat."""
    with pytest.raises(ValueError, match=rf"must be less than {larger}"):
        FilterSettings(**smaller)


def test_a_vehicle_must_be_able_to_brake_for_the_touch() -> None:
    """Braking so hard that a late vehicle would still be too fast is refused, with its reason."""
    with pytest.raises(ValueError, match=r"touch_mps = 0\.08 must exceed .* = 0\.096"):
        FilterSettings(brake_mps2=0.3)
    assert FilterSettings(brake_mps2=0.3, lag_s=0.1).command_lag_s == pytest.approx(0.12)


def test_one_gain_for_near_and_far_is_allowed() -> None:
    """The schedule may be switched off by equal gains."""
    assert FilterSettings(alpha_near=1.0, alpha_far=1.0).alpha_far == 1.0


@pytest.mark.parametrize("variant", [Variant.CUSP, Variant.PAPER])
def test_an_unsafe_variant_needs_its_flag(variant) -> None:
    """Without the explicit flag it is refused; with it, it is what was asked for."""
    with pytest.raises(ValueError, match="allow_unsafe_variant=True"):
        FilterSettings(variant=variant)
    allowed = FilterSettings(variant=variant, allow_unsafe_variant=True)
    expected = {Variant.CUSP: CuspFunnel(), Variant.PAPER: paper_funnel()}
    assert allowed.barrier == expected[variant]


def test_the_smooth_funnel_is_the_barrier() -> None:
    """By default the barrier is the funnel of the settings."""
    funnel = Funnel(2.0, 0.004, 0.03)
    assert FilterSettings(funnel=funnel).barrier is funnel


@pytest.mark.parametrize("age_ms", [50, 300, 800, 2000])
def test_the_clients_age_moves_all_phases(age_ms) -> None:
    """The drone closes in up to that age; the phases after it are as long as before."""
    settings = FilterSettings().with_age_max(age_ms * 1_000_000)
    assert settings.age_max_ns == age_ms * 1_000_000
    assert settings.hold_ns - settings.age_max_ns == 300_000_000
    assert settings.retreat_ns - settings.hold_ns == 900_000_000


@pytest.mark.parametrize(("age_ns", "expected_ns"), [(0, 1_000_000), (10**10, 2_000_000_000)])
def test_no_client_makes_it_fly_on_what_is_older_than_the_bound(age_ns, expected_ns) -> None:
    """An age out of bounds counts as the bound, also with phases that are long already."""
    long = FilterSettings(hold_ns=4_900_000_000, retreat_ns=9_900_000_000)
    assert long.with_age_max(age_ns).age_max_ns == expected_ns
    assert FilterSettings().with_age_max(age_ns).age_max_ns == expected_ns
