"""Quantiles of the last few durations."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from edge_service.recent import Recent


@given(st.lists(st.integers(0, 10**12), max_size=40), st.floats(0, 1), st.floats(0, 1))
def test_quantiles_are_of_the_last_and_in_order(spent_ns, a, b):
    """Always one of those kept; a larger share is never less; 0 when there is none."""
    recent = Recent(8)
    for ns in spent_ns:
        recent.note(ns)
    low_ns, high_ns = recent.quantile_ns(min(a, b), max(a, b))
    assert low_ns <= high_ns
    assert {low_ns, high_ns} <= set(spent_ns[-8:] or [0])


def test_median_and_p95():
    """Of 100 durations the 51st and the 96th."""
    recent = Recent(100)
    for ns in range(100):
        recent.note(ns)
    assert recent.quantile_ns(0.5, 0.95) == (50, 95)
