"""Frames under way: whose ack is missing, which is at risk, and which is too old to bother."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drone_client.under_way import KEPT_FRAMES, FramesUnderWay, UnderWay
from rgbd_wire.frame_codec import compress
from tests.unit.drone_client.builders import MS, frame

AGE_MAX_NS = 300 * MS


def under_way(sequence: int, t_ns: int, ack_due_ns: int | None = None) -> UnderWay:
    """A frame captured and sent at a time, to w1."""
    return UnderWay(
        sequence,
        compress(frame(t_ns)),
        ["w1"],
        t_ns,
        t_ns + 60 * MS if ack_due_ns is None else ack_due_ns,
    )


def used_to(round_trip_ns: int, count: int = 20) -> FramesUnderWay:
    """Frames that were answered after so long, and none under way."""
    frames = FramesUnderWay(AGE_MAX_NS)
    for n in range(count):
        frames.add(under_way(n, 0))
        frames.answered(n, round_trip_ns, looked_at=True)
    return frames


def test_a_missing_ack_counts_once_and_an_acknowledged_frame_never():
    """Due is due: at the nanosecond, and then no more."""
    frames = FramesUnderWay(AGE_MAX_NS)
    frames.add(under_way(1, 0))
    frames.add(under_way(2, 0))
    frames.get(2).acked_by = "w1"
    assert frames.missing_acks(60 * MS - 1) == []
    assert [f.sequence for f in frames.missing_acks(60 * MS)] == [1]
    assert frames.missing_acks(61 * MS) == []


def test_a_frame_too_old_is_let_go_of():
    """Past age_max nobody waits for it."""
    frames = FramesUnderWay(AGE_MAX_NS)
    frames.add(under_way(1, 0))
    frames.add(under_way(2, 10 * MS))
    assert frames.too_old(AGE_MAX_NS) == []
    assert [f.sequence for f in frames.too_old(AGE_MAX_NS + 1)] == [1]
    assert frames.newest.sequence == 2
    assert len(frames) == 1


@given(st.integers(1, 40))
def test_memory_is_bounded_and_the_newest_stay(count):
    """Nobody answers: the oldest go."""
    frames = FramesUnderWay(AGE_MAX_NS)
    for n in range(count):
        frames.add(under_way(n, n))
    assert len(frames) == min(count, KEPT_FRAMES)
    assert frames.newest.sequence == count - 1


def test_a_frame_is_at_risk_when_it_is_later_than_most_and_a_second_copy_can_make_it():
    """Usual 50 ms: at 51 ms a copy goes, unless the other worker would be too late as well."""
    frames = used_to(50 * MS)
    frames.add(under_way(99, 0))
    assert frames.at_risk(50 * MS, 60 * MS) is None
    assert frames.at_risk(51 * MS, 60 * MS).sequence == 99
    assert frames.at_risk(51 * MS, 249 * MS).sequence == 99
    assert frames.at_risk(51 * MS, 250 * MS) is None


def test_no_frame_gets_a_third_copy_and_nothing_is_hedged_without_experience():
    """Two at most; and without answers so far, late means nothing."""
    frames = used_to(50 * MS)
    frames.add(under_way(99, 0))
    frames.get(99).workers.append("w2")
    assert frames.at_risk(100 * MS, 1) is None
    green = used_to(50 * MS, count=7)
    green.add(under_way(99, 0))
    assert green.at_risk(100 * MS, 1) is None


def test_answers_of_copies_and_answers_without_a_look_teach_nothing():
    """A superseded frame is answered at once; a copy's time is not the worker's."""
    frames = FramesUnderWay(AGE_MAX_NS)
    for n in range(20):
        frames.add(under_way(n, 0))
        frames.answered(n, 1, looked_at=False)
        frames.add(under_way(n, 0))
        frames.get(n).workers.append("w2")
        frames.answered(n, 1, looked_at=True)
    frames.add(under_way(99, 0))
    assert frames.at_risk(100 * MS, 1) is None
