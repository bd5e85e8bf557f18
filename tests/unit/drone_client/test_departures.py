"""Departures: the window holds, the link neither idles nor queues; against a simulated link."""

import heapq

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.departures import MIN_LEAD_NS, Departures

MS = 1_000_000


def fly(serialisation_ns, delay_ns, period_ns, window=2, frames=120, predicted=1.0):
    """Ages at arrival, arrival times and the link's queueing of a camera over a serial link.

    An event simulation, independent of the code under test: captures come every ``period_ns``, the
    newest one goes when it may, the link carries one frame at a time.
    """
    departures = Departures(window, 10**12)
    events = [(n * period_ns, 0, n) for n in range(frames)]  # time, kind (0 capture, 1 ack, 2 wake)
    heapq.heapify(events)
    waiting = None
    link_free_ns = 0
    ages, arrivals, queued = [], [], []
    while events:
        now_ns, kind, n = heapq.heappop(events)
        if kind == 0:
            waiting = (n, now_ns)
        elif kind == 1:
            departures.release(n, now_ns, 2 * delay_ns)
        if waiting is None:
            continue
        wait_ns = departures.wait_ns(now_ns)
        if wait_ns is None:
            continue
        if wait_ns > 0:
            heapq.heappush(events, (now_ns + wait_ns, 2, -1))
            continue
        sequence, captured_ns = waiting
        waiting = None
        departures.send(sequence, "w1", now_ns, round(predicted * serialisation_ns))
        start_ns = max(link_free_ns, now_ns + delay_ns)
        queued.append(start_ns - now_ns - delay_ns)
        link_free_ns = start_ns + serialisation_ns
        ages.append(link_free_ns - captured_ns)
        arrivals.append(link_free_ns)
        heapq.heappush(events, (link_free_ns + delay_ns, 1, sequence))
    return ages, arrivals, queued


serialisations = st.integers(34 * MS, 120 * MS)


@given(serialisations, st.integers(0, 20 * MS))
def test_a_link_that_is_too_slow_is_never_idle_and_queues_no_more_than_the_lead(s_ns, delay_ns):
    """Frames arrive back to back, and none has waited in the link longer than the lead."""
    _, arrivals, queued = fly(s_ns, delay_ns, 33 * MS)
    gaps = [b - a for a, b in zip(arrivals[3:-3], arrivals[4:-2], strict=True)]
    if 2 * delay_ns <= s_ns:  # the window of two covers the round trip
        assert max(gaps) <= s_ns + 1
    assert max(queued[3:]) <= max(MIN_LEAD_NS, 0.1 * s_ns) + 2


@given(serialisations, st.integers(0, 5 * MS))
def test_what_arrives_is_no_older_than_a_period_the_lead_and_the_way(s_ns, delay_ns):
    """Capture to arrival: at most one camera period on board, then the lead, then the link.

    The last frames of all have no newer one that could take their place on board.
    """
    ages, _, _ = fly(s_ns, delay_ns, 33 * MS)
    lead_ns = max(MIN_LEAD_NS, 0.1 * s_ns)
    assert max(ages[3:-3]) <= 33 * MS + lead_ns + s_ns + delay_ns + 2


@given(serialisations, st.floats(0.3, 2.0))
def test_a_wrong_prediction_stays_within_the_window(s_ns, predicted):
    """A link that is slower or faster than predicted: the ack clock still bounds the queue."""
    _, arrivals, queued = fly(s_ns, 2 * MS, 33 * MS, predicted=predicted)
    assert max(queued) <= s_ns
    assert len(arrivals) >= 30


@given(st.integers(1 * MS, 10 * MS))
def test_a_link_that_is_fast_enough_loses_no_frame(s_ns):
    """Every capture goes, at once."""
    ages, arrivals, _ = fly(s_ns, 1 * MS, 33 * MS)
    assert len(arrivals) == 120
    assert max(ages) == s_ns + 1 * MS


def test_without_a_prediction_the_window_alone_decides():
    """Serialisation 0: the second frame goes at once, the third waits for an ack."""
    departures = Departures(2, 500)
    departures.send(1, "w1", 0, 0)
    assert departures.wait_ns(0) == 0
    departures.send(2, "w1", 0, 0)
    assert departures.wait_ns(0) is None
    assert departures.expire(500) == (1, 2)
    assert departures.wait_ns(500) == 0


def test_encoding_time_is_taken_off_the_wait():
    """The frame is taken, encoded, and leaves just in time."""
    departures = Departures(2, 10**12)
    departures.send(1, "w1", 0, 50 * MS)
    assert departures.wait_ns(0) == 45 * MS
    assert departures.wait_ns(0, preparation_ns=6 * MS) == 39 * MS


def test_an_ack_frees_the_older_slots_as_well():
    """An ack that was lost holds up nothing: the next one says that the link got so far."""
    departures = Departures(3, 10**12)
    for sequence in (1, 2, 3):
        departures.send(sequence, "w1", sequence, 50 * MS)
    assert departures.release(2, 120 * MS, 0)
    assert departures.in_flight == 1
    assert departures.wait_ns(120 * MS) == 45 * MS  # frame 3 is in the link now
    assert not departures.release(1, 121 * MS, 0)


def test_an_ack_of_one_worker_says_nothing_of_another_one_s_frames():
    """Frame 1 is still on its way to the worker that was left."""
    departures = Departures(3, 10**12)
    departures.send(1, "w1", 0, 50 * MS)
    departures.send(2, "w2", 1, 50 * MS)
    assert departures.release(2, 60 * MS, 0)
    assert departures.in_flight == 1


@pytest.mark.parametrize("sequence", [7, -1])
def test_an_ack_of_what_is_not_under_way_frees_nothing(sequence):
    """Late, repeated or made up."""
    departures = Departures(1, 500)
    departures.send(1, "w1", 0, 100)
    assert not departures.release(sequence, 10, 0)
    assert departures.wait_ns(10) is None
