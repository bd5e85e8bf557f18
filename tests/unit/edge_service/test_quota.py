"""Each drone's rate: kept by those that keep it, whatever the others do."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from edge_service.quota import Pace, Quotas

SECOND_NS = 1_000_000_000


def paces(quotas, drone, rate_hz, seconds):
    """What a drone is told that sends evenly."""
    n = rate_hz * seconds
    return Counter(quotas.pace(drone, k * SECOND_NS // rate_hz) for k in range(n))


def test_who_keeps_to_the_rate_is_never_too_fast():
    """Right at the rate, for long."""
    assert paces(Quotas(60, 4), "a", 60, 20) == {Pace.FINE: 1200}


def test_of_a_drone_at_ten_times_the_rate_a_bounded_share_is_looked_at():
    """The rate is taken, as much again is told, and the rest costs nothing."""
    told = paces(Quotas(60, 4), "a", 600, 10)
    assert 600 <= told[Pace.FINE] <= 600 + 15
    assert 600 <= told[Pace.TOO_FAST] <= 600 + 15
    assert told[Pace.FLOOD] == 6000 - told[Pace.FINE] - told[Pace.TOO_FAST]


def test_one_drones_flood_is_not_held_against_another():
    """Each has a bucket of its own."""
    quotas = Quotas(30, 4)
    for _ in range(1000):
        quotas.pace("loud", 0)
    assert quotas.pace("loud", 0) is Pace.FLOOD
    assert quotas.pace("quiet", 0) is Pace.FINE


def test_a_whole_window_may_come_at_once():
    """After a stall the link hands over what it held; at a low rate, too."""
    quotas = Quotas(1, 4)
    assert [quotas.pace("a", 0) for _ in range(9)] == [Pace.FINE] * 8 + [Pace.TOO_FAST]


@given(st.lists(st.text(max_size=3), max_size=60))
def test_memory_is_bounded_whatever_names_come(names):
    """Strangers push out those heard longest ago, and no more are kept than may be."""
    quotas = Quotas(60, 5)
    for name in names:
        quotas.pace(name, 0)
    assert len(quotas) <= 5
