"""Batches: never past the tightest budget in them, and no waiting for its own sake."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st

from edge_service.batching import BatchLimits, gather, wait_for_more_ns
from rgbd_wire.clock import ManualClock

TIMES = st.integers(0, 1000)


@dataclass(frozen=True)
class Item:
    """A frame that comes at some time, and must be answered by another."""

    comes_ns: int
    deadline_ns: int


class Line:
    """Items that come as the clock goes; waiting for one moves the clock to where it comes."""

    def __init__(self, clock, items):
        self.clock = clock
        self.items = sorted(items, key=lambda item: item.comes_ns)

    def take(self, wait_ns, accept):
        assert wait_ns >= 0
        end_ns = self.clock.now_ns() + wait_ns
        for item in list(self.items):
            if item.comes_ns > end_ns:
                break
            self.clock.advance(max(0, item.comes_ns - self.clock.now_ns()))
            if accept(item):
                self.items.remove(item)
                return item
        self.clock.advance(end_ns - self.clock.now_ns())
        return None


def costs(steps):
    """A cost by size that never falls."""
    return lambda size: sum(steps[: min(size, len(steps))])


def gathered(first, items, steps, limits):
    """The batch, and when it was begun."""
    clock = ManualClock(first.comes_ns)
    line = Line(clock, items)
    batch = gather(
        first, line.take, lambda item: item.deadline_ns, costs(steps), limits, clock.now_ns
    )
    return batch, clock.now_ns()


@given(
    st.builds(Item, st.just(0), TIMES),
    st.lists(st.builds(Item, TIMES, st.integers(0, 2000)), max_size=12),
    st.lists(st.integers(0, 200), min_size=1, max_size=16),
    st.builds(BatchLimits, st.integers(1, 16), TIMES),
)
def test_a_batch_never_waits_past_its_tightest_budget(first, items, steps, limits):
    """All that would have made it alone still make it, by what is expected of the whole batch."""
    batch, begun_ns = gathered(first, items, steps, limits)
    takes_ns = costs(steps)(len(batch))
    assert batch[0] is first
    assert len(batch) <= limits.max_size
    assert begun_ns <= limits.wait_ns
    if costs(steps)(1) > first.deadline_ns:
        assert (batch, begun_ns) == ([first], 0)  # it is late anyway: at least not later
    else:
        assert all(begun_ns + takes_ns <= item.deadline_ns for item in batch)


@given(TIMES, TIMES, TIMES, TIMES)
def test_the_wait_is_the_shorter_of_slack_and_patience(tightest_ns, expected_ns, until_ns, now_ns):
    """Waited to the end, the larger batch is done when the tightest budget is over, or before."""
    wait_ns = wait_for_more_ns(tightest_ns, expected_ns, until_ns, now_ns)
    if wait_ns >= 0:
        assert now_ns + wait_ns + expected_ns <= tightest_ns
        assert wait_ns == 0 or now_ns + wait_ns <= until_ns
    else:
        assert now_ns + expected_ns > tightest_ns


def test_without_patience_only_those_at_hand_go_together():
    """Wait 0: whoever is there comes along, and nobody is waited for."""
    at_hand, later = Item(0, 500), Item(1, 500)
    batch, begun_ns = gathered(Item(0, 500), [at_hand, later], [10] * 4, BatchLimits(4, 0))
    assert (len(batch), begun_ns) == (2, 0)


def test_a_full_batch_begins_at_once():
    """With the last place taken there is nobody to wait for."""
    items = [Item(3, 500), Item(5, 500), Item(6, 500)]
    batch, begun_ns = gathered(Item(0, 500), items, [10] * 4, BatchLimits(3, 400))
    assert (len(batch), begun_ns) == (3, 5)


def test_who_would_be_late_in_the_batch_is_left_for_the_next_one():
    """A tight budget that fits alone, but not among others, does not spoil the batch."""
    tight, easy = Item(0, 15), Item(0, 900)
    batch, _ = gathered(Item(0, 900), [tight, easy], [10, 10, 10], BatchLimits(2, 0))
    assert batch == [Item(0, 900), easy]
