"""Quantiles of durations in bounded memory."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from link_emulator.histogram import Histogram

durations = st.lists(st.integers(0, 19_999_000), min_size=1, max_size=100)


@given(durations, st.floats(0.01, 1))
def test_quantile_is_right_to_a_microsecond(values_ns: list[int], q: float) -> None:
    """Never under the true one, and at most a bucket above it."""
    histogram = Histogram()
    for value in values_ns:
        histogram.add(value)
    true_ns = sorted(values_ns)[max(1, math.ceil(q * len(values_ns))) - 1]
    assert true_ns <= histogram.quantile_ns(q) <= true_ns + 1000
    assert histogram.max_ns == max(values_ns)


@given(durations, durations)
def test_merged_is_as_if_all_were_counted_in_one(a: list[int], b: list[int]) -> None:
    """Both directions of a relay make one figure."""
    one, other, both = Histogram(), Histogram(), Histogram()
    for histogram, values in ((one, a), (other, b), (both, a + b)):
        for value in values:
            histogram.add(value)
    one.merge(other)
    assert one.total == both.total
    assert [one.quantile_ns(q / 10) for q in range(11)] == [
        both.quantile_ns(q / 10) for q in range(11)
    ]


def test_longest_is_exact_past_the_last_bucket() -> None:
    """And an empty one gives zero."""
    histogram = Histogram()
    assert histogram.quantile_ns(0.5) == 0
    histogram.add(3_000_000_000)
    assert histogram.quantile_ns(0.99) == 3_000_000_000
