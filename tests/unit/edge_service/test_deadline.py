"""Who is dropped, what that is told, and that a wrong estimate rights itself."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from edge_service.deadline import TRY_EVERY_NS, Deadline, Prospect, Ruling
from edge_service.pipeline import MAX_REASON_CHARACTERS
from edge_service.service_time import FRESH_NS, WINDOW, ServiceTime
from rgbd_wire.messages import Outcome

MS = 1_000_000
NS = st.integers(0, 2**63 - 1)


def expecting(expected_ns):
    """An estimate of that much, now."""
    times = ServiceTime()
    times.note(1, expected_ns, 0)
    return times


def test_a_dropped_frame_is_told_the_numbers():
    """What it waited, what it would have taken, and what it had."""
    output = Prospect(80 * MS, 35 * MS, 100 * MS).dropped()
    assert output.outcome is Outcome.DROPPED
    assert output.reason == "waited 80 ms, service takes 35 ms, budget 100 ms"


@given(NS, NS, NS)
def test_the_numbers_fit_the_wire(waited_ns, expected_ns, budget_ns):
    """Whatever budget a drone makes up, the reason is one that a result may carry."""
    assert len(Prospect(waited_ns, expected_ns, budget_ns).dropped().reason) <= (
        MAX_REASON_CHARACTERS
    )


@given(NS, NS, NS)
def test_exactly_those_that_make_it_are_served(waited_ns, expected_ns, budget_ns):
    """To the nanosecond; and one whose budget is spent is not even tried."""
    prospect = Prospect(waited_ns, expected_ns, budget_ns)
    ruling, got = Deadline(expecting(expected_ns)).rule(waited_ns, budget_ns, 0)
    assert got == prospect
    assert (ruling is Ruling.SERVE) == (waited_ns + expected_ns <= budget_ns)
    assert (ruling is Ruling.DROP) == (waited_ns > budget_ns)


@given(st.lists(st.integers(0, TRY_EVERY_NS), max_size=50))
def test_tries_are_rare(steps_ns):
    """However many should be late, one is tried in each spell, and no more."""
    times = ServiceTime()
    deadline, now_ns, tried_ns = Deadline(times), 0, []
    for step_ns in steps_ns:
        now_ns += step_ns
        times.note(1, 50, now_ns)
        if deadline.rule(0, 40, now_ns)[0] is Ruling.TRY:
            tried_ns.append(now_ns)
    assert tried_ns[:1] == ([sum(steps_ns[:1])] if steps_ns else [])
    assert all(b - a >= TRY_EVERY_NS for a, b in zip(tried_ns, tried_ns[1:], strict=False))


def test_a_try_stays_one():
    """What was let in to be tried is served when its turn comes, unless its budget is spent."""
    deadline = Deadline(expecting(50))
    assert deadline.rule(0, 40, 0)[0] is Ruling.TRY
    assert deadline.rule(5, 40, 5, is_try=True)[0] is Ruling.TRY
    assert deadline.rule(5, 40, 5)[0] is Ruling.DROP
    assert deadline.rule(41, 40, 41, is_try=True)[0] is Ruling.DROP


@given(
    st.lists(st.integers(101 * MS, 10_000 * MS), max_size=WINDOW),
    st.integers(1, 60),
    st.integers(1, 100),
)
def test_it_never_locks_itself_out(slow_ns, rate_hz, takes_ms):
    """After any slow spell a worker that is fast again serves every frame within three seconds."""
    times = ServiceTime()
    deadline = Deadline(times)
    for spent_ns in slow_ns:
        times.note(1, spent_ns, 0)
    period_ns, recovered_ns = 1_000 * MS // rate_hz, FRESH_NS + 1_000 * MS
    for now_ns in range(0, 2 * recovered_ns, period_ns):
        ruling, _ = deadline.rule(0, 100 * MS, now_ns)
        if ruling is not Ruling.DROP:
            times.note(1, takes_ms * MS, now_ns)
        if now_ns > recovered_ns:
            assert ruling is Ruling.SERVE
