"""Goodput: converges on a simulated link, follows a fall in three frames and a rise in seven."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from drone_client.goodput import LARGEST_BYTES_PER_S, Goodput

MS = 1_000_000
PERIOD_NS = 33 * MS

rates = st.floats(1e5, 2e7)
delays_ns = st.integers(0, 40 * MS)


class Link:
    """A serial link with a delay each way: an independent account of when acks come back."""

    def __init__(self, delay_ns: int) -> None:
        self.delay_ns = delay_ns
        self.free_ns = 0
        self.now_ns = 0
        self.last_ack_ns = 0

    def send(self, size_bytes: int, rate: float) -> tuple[int, int]:
        """Send when the frame before the last is through; t1 and the ack's time."""
        t1_ns = max(self.now_ns, self.free_ns)
        start_ns = max(t1_ns + self.delay_ns, self.free_ns + self.delay_ns)
        through_ns = start_ns + round(size_bytes / rate * 1e9)
        self.free_ns = through_ns - self.delay_ns
        self.now_ns = t1_ns + PERIOD_NS
        return t1_ns, through_ns + self.delay_ns


def fly(estimate: Goodput, link: Link, rate: float, count: int, size: int = 100_000) -> None:
    """Frames over the link, all acknowledged."""
    for _ in range(count):
        t1_ns, t_ack_ns = link.send(size, rate)
        estimate.acked(size, t1_ns, t_ack_ns, 2 * link.delay_ns)


def test_without_an_ack_nothing_is_known():
    """None, not a guess."""
    assert Goodput().bytes_per_s is None


@given(rates, delays_ns)
def test_converges_on_the_link_s_rate(rate, delay_ns):
    """Within 1 % after the first few acks, whatever the delay."""
    estimate = Goodput()
    fly(estimate, Link(delay_ns), rate, 8)
    assert math.isclose(estimate.bytes_per_s, rate, rel_tol=0.01)


@given(st.floats(5e5, 1e7), st.floats(0.2, 0.6), delays_ns)
def test_a_fall_is_followed_within_three_frames(rate, share, delay_ns):
    """Two of the last three samples are the new rate's."""
    estimate, link = Goodput(), Link(delay_ns)
    fly(estimate, link, rate, 10)
    fly(estimate, link, share * rate, 3)
    assert estimate.bytes_per_s <= 1.05 * share * rate


@given(st.floats(5e5, 5e6), st.floats(1.5, 4.0), delays_ns)
def test_a_rise_is_followed_within_a_second(rate, factor, delay_ns):
    """Seven samples: a quarter of a second at 30 Hz, half a second at 15."""
    estimate, link = Goodput(), Link(delay_ns)
    fly(estimate, link, rate, 10)
    fly(estimate, link, rate * factor, 7)
    assert estimate.bytes_per_s >= 0.95 * rate * factor


def test_one_lucky_ack_does_not_raise_it():
    """Acks that were held back and came at once would look like a link of a gigabit."""
    estimate, link = Goodput(), Link(5 * MS)
    fly(estimate, link, 1e6, 10)
    estimate.acked(100_000, link.now_ns, link.now_ns + 10 * MS, 10 * MS)
    assert estimate.bytes_per_s <= 1.05e6


@given(
    st.floats(5e5, 5e6),
    delays_ns,
    st.lists(st.integers(0, 4 * MS), min_size=60, max_size=60),
)
def test_jitter_of_the_acks_does_not_carry_it_away(rate, delay_ns, late_ns):
    """An ack that is a few ms late takes from its own sample and gives to the next one."""
    estimate, link = Goodput(), Link(delay_ns)
    for n, extra_ns in enumerate(late_ns):
        t1_ns, t_ack_ns = link.send(100_000, rate)
        estimate.acked(100_000, t1_ns, t_ack_ns + extra_ns, 2 * delay_ns)
        if n > 10:
            spare = 1e5 / rate * 1e9
            assert rate * spare / (spare + 4.1 * MS) <= estimate.bytes_per_s
            assert estimate.bytes_per_s <= rate * spare / (spare - 4.1 * MS)


@given(st.floats(5e5, 5e6), delays_ns, st.integers(2, 9))
def test_lost_acks_do_not_carry_it_away(rate, delay_ns, every):
    """A sample over two frames' time is low; the median passes over one in three, or halves."""
    estimate, link = Goodput(), Link(delay_ns)
    for n in range(60):
        t1_ns, t_ack_ns = link.send(100_000, rate)
        if n % every:
            estimate.acked(100_000, t1_ns, t_ack_ns, 2 * delay_ns)
    least = 0.99 if every > 4 else 0.49
    assert least * rate <= estimate.bytes_per_s <= 1.01 * rate


@given(st.floats(5e5, 1e7), st.floats(0.01, 0.2), delays_ns)
def test_a_time_out_is_an_upper_bound_taken_at_once(rate, seconds, delay_ns):
    """A link that went silent is no faster than what it did not carry; the next ack tells more."""
    estimate, link = Goodput(), Link(delay_ns)
    fly(estimate, link, rate, 10)
    before = estimate.bytes_per_s
    t1_ns = link.now_ns + 10**9
    estimate.timed_out(1000, t1_ns, t1_ns + round(seconds * 1e9))
    assert estimate.bytes_per_s <= min(before, 1.01 * 1000 / seconds)
    late_ns = t1_ns + 2 * 10**9
    estimate.acked(1000, t1_ns, late_ns, 0)
    assert math.isclose(estimate.bytes_per_s, 500, rel_tol=0.01)  # and the past is forgotten


def test_a_time_out_before_any_ack_is_the_first_that_is_known():
    """A drone that starts on a link that is far too slow learns it from silence."""
    estimate = Goodput()
    estimate.timed_out(60_000, 0, 500 * MS)
    assert estimate.bytes_per_s == 120_000


times = st.integers(0, 2**62)


@given(st.lists(st.tuples(st.integers(1, 2**23), times, times, times), max_size=40))
def test_no_stamps_make_it_a_number_that_is_none(acks):
    """Out of order, at once, backwards: positive, finite, bounded."""
    estimate = Goodput()
    for size, t1_ns, t_ack_ns, round_trip_ns in acks:
        estimate.acked(size, t1_ns, t_ack_ns, round_trip_ns)
        assert 0 < estimate.bytes_per_s <= LARGEST_BYTES_PER_S
