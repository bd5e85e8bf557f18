"""What a frame is expected to take: robust, fresh, and never falling with the size of a batch."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from edge_service.service_time import FRESH_NS, WINDOW, ServiceTime

NS = st.integers(0, 10**10)
NOTES = st.lists(st.tuples(st.integers(1, 16), NS, st.integers(0, 2 * FRESH_NS)), max_size=80)


def noted(notes):
    """The estimate after notes in order of their time, and the time of the last one."""
    times = ServiceTime()
    for size, spent_ns, at_ns in sorted(notes, key=lambda note: note[2]):
        times.note(size, spent_ns, at_ns)
    return times, max((note[2] for note in notes), default=0)


def test_before_the_first_frame_nothing_is_expected():
    """Nobody knows, so nobody is turned away."""
    assert ServiceTime().expected_ns(5) == 0
    assert ServiceTime().expected_ns(5, size=4) == 0


def test_one_slow_frame_changes_little():
    """The median of those of late; of two the kinder one."""
    times = ServiceTime()
    times.note(1, 900, 0)
    assert times.expected_ns(0) == 900
    times.note(1, 30, 1)
    assert times.expected_ns(1) == 30
    for n in range(2, 10):
        times.note(1, 30 + n, n)
    times.note(1, 10**9, 11)
    assert 30 < times.expected_ns(11) < 40


@given(NOTES)
def test_it_lies_between_what_was_measured(notes):
    """For one frame never less than the fastest fresh sample, nor more than the slowest."""
    times, now_ns = noted(notes)
    fresh = [spent_ns for _, spent_ns, at_ns in notes if now_ns - at_ns <= FRESH_NS]
    if fresh:
        assert min(fresh) <= times.expected_ns(now_ns) <= max(fresh)


@given(NOTES)
def test_a_larger_batch_never_takes_less(notes):
    """What is measured of a large batch may be faster by chance; what is expected is not."""
    times, now_ns = noted(notes)
    expected = [times.expected_ns(now_ns, size) for size in range(1, 17)]
    assert expected == sorted(expected)


@given(NOTES, st.integers(1, 16))
def test_whatever_was_measured_is_forgotten(notes, size):
    """No figure stays without being measured again, so none can turn frames away for ever."""
    times, now_ns = noted(notes)
    assert times.expected_ns(now_ns + FRESH_NS + 1, size) == 0


@given(st.lists(NS, min_size=WINDOW, max_size=WINDOW), NOTES)
def test_only_the_last_window_counts(last, notes):
    """What came before the last samples of a size makes no difference."""
    times, now_ns = noted(notes)
    alone = ServiceTime()
    for size in range(1, 17):
        for spent_ns in last:
            times.note(size, spent_ns, now_ns)
            alone.note(size, spent_ns, now_ns)
    assert times.expected_ns(now_ns, 3) == alone.expected_ns(now_ns, 3)


def test_an_unknown_size_costs_as_much_for_each_frame_as_the_next_smaller_one():
    """But no more than the next larger one, which has been measured."""
    times = ServiceTime()
    times.note(2, 40, 0)
    assert [times.expected_ns(0, size) for size in (1, 2, 3, 4)] == [40, 40, 60, 80]
    times.note(5, 70, 0)
    assert [times.expected_ns(0, size) for size in (1, 2, 3, 4, 5, 10)] == [40, 40, 60, 70, 70, 140]
