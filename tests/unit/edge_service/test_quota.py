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


def test_of_a_drone_that_floods_next_to_nothing_is_taken():
    """At ten times the rate: what may come at once, then one a second, however long it lasts."""
    told = paces(Quotas(60, 4), "a", 600, 20)
    assert 15 + 18 <= told[Pace.FINE] <= 15 + 24
    assert told[Pace.TOO_FAST] <= 60 * 20 + 15
    assert told[Pace.FLOOD] == 12_000 - told[Pace.FINE] - told[Pace.TOO_FAST]


def test_who_is_a_little_too_fast_is_served_at_the_rate():
    """Up to twice the rate it is told, and keeps what it may have."""
    told = paces(Quotas(60, 4), "a", 100, 10)
    assert 600 <= told[Pace.FINE] <= 615
    assert told[Pace.FLOOD] == 0


def test_after_a_flood_a_drone_is_served_as_before():
    """A second after it has stopped, with no more at once than anybody else."""
    quotas = Quotas(60, 4)
    paces(quotas, "a", 600, 5)
    start_ns = 5 * SECOND_NS
    calm = [quotas.pace("a", start_ns + k * SECOND_NS // 50) for k in range(150)]
    assert calm[:50].count(Pace.FINE) <= 2
    assert set(calm[51:]) == {Pace.FINE}


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
