"""The delay gate: what it accepts never depends on the worker's clock."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.gate import (
    GateSettings,
    ResultStamps,
    SentFrame,
    Verdict,
    judge,
    network_delay_ns,
)
from drone_client.sent_frames import SentFrames

MS = 1_000_000
HOUR = 3_600_000 * MS
SETTINGS = GateSettings(tau_max_ns=250 * MS, age_max_ns=400 * MS)
SENT = SentFrame(
    sequence=7, t_capture_ns=1_000 * MS, t1_ns=1_010 * MS, worker="w1", acknowledged_by=42
)

durations_ns = st.integers(0, 500 * MS)


def stamps_of(
    sent: SentFrame, d1_ns: int, service_ns: int, d2_ns: int, worker_minus_drone_ns: int = 0
) -> ResultStamps:
    """Stamps of a result that took these times, on a worker whose clock is that far ahead."""
    t2_true_ns = sent.t1_ns + d1_ns
    t3_true_ns = t2_true_ns + service_ns
    return ResultStamps(
        worker="w1",
        worker_boot_id=42,
        t_capture_ns=sent.t_capture_ns,
        t1_ns=sent.t1_ns,
        t2_ns=t2_true_ns + worker_minus_drone_ns,
        t3_ns=t3_true_ns + worker_minus_drone_ns,
        t4_ns=t3_true_ns + d2_ns,
    )


@given(durations_ns, durations_ns, durations_ns, st.integers(-HOUR, HOUR))
def test_network_delay_is_exact_to_the_nanosecond_under_any_clock_offset(d1, service, d2, offset):
    """(t4-t1)-(t3-t2) is d1+d2 whatever the worker's clock says."""
    assert network_delay_ns(stamps_of(SENT, d1, service, d2, offset)) == d1 + d2


@given(durations_ns, durations_ns, durations_ns)
def test_a_result_is_accepted_exactly_when_both_bounds_hold(d1, service, d2):
    """An independent reading of the contract: the two inequalities, nothing else."""
    judgement = judge(stamps_of(SENT, d1, service, d2), SENT, None, SETTINGS)
    age_ns = (SENT.t1_ns - SENT.t_capture_ns) + d1 + service + d2
    expected = d1 + d2 <= SETTINGS.tau_max_ns and age_ns <= SETTINGS.age_max_ns
    assert judgement.accepted is expected
    assert judgement.network_delay_ns == d1 + d2
    assert judgement.age_ns == age_ns


traffic = st.lists(
    st.tuples(st.integers(1, 60 * MS), durations_ns, st.integers(0, 120 * MS), durations_ns),
    min_size=1,
    max_size=30,
)


def accepted_sequences(events, worker_time_ns) -> list[int]:
    """Sequences a gate accepts when the worker's clock reads ``worker_time_ns(true time)``."""
    gate = SentFrames(SETTINGS)
    results = []
    t_ns = HOUR
    for sequence, (gap_ns, d1_ns, service_ns, d2_ns) in enumerate(events):
        t_ns += gap_ns
        sent = SentFrame(sequence, t_ns - 5 * MS, t_ns, "w1")
        gate.add(sent)
        gate.acknowledge(sequence, "w1", 42)
        true = stamps_of(sent, d1_ns, service_ns, d2_ns)
        results.append(
            (
                sequence,
                replace(true, t2_ns=worker_time_ns(true.t2_ns), t3_ns=worker_time_ns(true.t3_ns)),
            )
        )
    results.sort(key=lambda r: r[1].t4_ns)  # they arrive when they arrive
    return [sequence for sequence, stamps in results if gate.judge(sequence, stamps).accepted]


@given(traffic, st.integers(-HOUR, HOUR))
def test_accepted_set_is_identical_under_any_clock_offset(events, offset_ns):
    """A worker an hour ahead or behind changes nothing, not even the order."""
    assert accepted_sequences(events, lambda t: t + offset_ns) == accepted_sequences(
        events, lambda t: t
    )


@given(traffic, st.floats(-200e-6, 200e-6))
def test_accepted_set_is_identical_under_200_ppm_of_drift(events, drift):
    """A clock that runs 200 ppm fast or slow stretches t3-t2 by at most 24 us for 120 ms."""
    worst_ns = 1 + int(200e-6 * 120 * MS)
    events = [e for e in events if abs(e[1] + e[3] - SETTINGS.tau_max_ns) > worst_ns and e[2] > 0]
    # A service time may not exceed the round trip: with a fast clock and no network it would.
    events = [e for e in events if e[1] + e[3] > worst_ns]
    assert accepted_sequences(events, lambda t: t + round(drift * t)) == accepted_sequences(
        events, lambda t: t
    )


@given(traffic, st.integers(-HOUR, HOUR), st.integers(0, 30 * 60 * MS))
def test_a_step_of_the_workers_clock_between_frames_changes_nothing(events, step_ns, after_ns):
    """A step that falls in no frame's service time leaves every t3-t2 as it was."""
    step_at_ns = HOUR + after_ns
    true = accepted_sequences(events, lambda t: t)
    served, t_ns = [], HOUR
    for gap_ns, d1_ns, service_ns, _ in events:
        t_ns += gap_ns
        served.append((t_ns + d1_ns, t_ns + d1_ns + service_ns))
    if any(t2 < step_at_ns <= t3 for t2, t3 in served):
        return
    assert accepted_sequences(events, lambda t: t + (step_ns if t >= step_at_ns else 0)) == true


@given(durations_ns, durations_ns, durations_ns, st.integers(1, HOUR))
def test_a_step_inside_the_service_time_can_only_refuse(d1, service, d2, step_ns):
    """A clock stepped back between t2 and t3 inflates the delay: nothing late becomes fresh."""
    true = stamps_of(SENT, d1, service, d2)
    stepped = replace(true, t3_ns=true.t3_ns - step_ns)
    if judge(stepped, SENT, None, SETTINGS).accepted:
        assert judge(true, SENT, None, SETTINGS).accepted


@given(durations_ns, durations_ns, durations_ns, st.integers(1, HOUR))
def test_a_worker_that_inflates_its_service_time_cannot_pass_off_an_old_result(
    d1, service, d2, lie_ns
):
    """The age is the drone's own: whatever a worker claims, nothing past age_max is accepted."""
    true = stamps_of(SENT, d1, service, d2)
    judgement = judge(replace(true, t3_ns=true.t3_ns + lie_ns), SENT, None, SETTINGS)
    if judgement.accepted:
        assert true.t4_ns - SENT.t_capture_ns <= SETTINGS.age_max_ns


GOOD = stamps_of(SENT, 20 * MS, 30 * MS, 20 * MS)


@pytest.mark.parametrize(
    ("stamps", "sent", "last_ns", "verdict"),
    [
        (GOOD, SENT, None, Verdict.ACCEPTED),
        (GOOD, None, None, Verdict.NEVER_SENT),
        (GOOD, replace(SENT, answered=True), None, Verdict.DUPLICATE),
        (replace(GOOD, t1_ns=GOOD.t1_ns + 1), SENT, None, Verdict.ECHO_MISMATCH),
        (replace(GOOD, t_capture_ns=GOOD.t_capture_ns + 1), SENT, None, Verdict.ECHO_MISMATCH),
        (GOOD, replace(SENT, acknowledged_by=None), None, Verdict.NOT_ACKNOWLEDGED),
        (replace(GOOD, worker_boot_id=43), SENT, None, Verdict.WRONG_WORKER),
        (replace(GOOD, worker="w2"), SENT, None, Verdict.WRONG_WORKER),
        (replace(GOOD, t3_ns=GOOD.t2_ns - 1), SENT, None, Verdict.IMPOSSIBLE_TIME),
        (replace(GOOD, t3_ns=GOOD.t2_ns + HOUR), SENT, None, Verdict.IMPOSSIBLE_TIME),
        (stamps_of(SENT, 200 * MS, 0, 51 * MS), SENT, None, Verdict.NETWORK_DELAY),
        (stamps_of(SENT, 100 * MS, 200 * MS, 100 * MS), SENT, None, Verdict.TOO_OLD),
        (GOOD, SENT, SENT.t_capture_ns, Verdict.OUT_OF_ORDER),
        (GOOD, SENT, SENT.t_capture_ns + 1, Verdict.OUT_OF_ORDER),
    ],
)
def test_each_reason_is_told_by_its_name(stamps, sent, last_ns, verdict):
    """One result for each verdict."""
    assert judge(stamps, sent, last_ns, SETTINGS).verdict is verdict


def test_an_answer_without_a_look_is_no_knowledge_and_puts_nothing_out_of_order():
    """Superseded frame 8 is answered at once; frame 7, still at work then, is accepted after it."""
    gate = SentFrames(SETTINGS)
    later = replace(SENT, sequence=8, t_capture_ns=SENT.t_capture_ns + 33 * MS)
    for sent in (SENT, later):
        gate.add(sent)
    superseded = replace(GOOD, t_capture_ns=later.t_capture_ns)
    judgement = gate.judge(8, superseded, looked_at=False)
    assert judgement.verdict is Verdict.NOT_LOOKED_AT
    assert judgement.network_delay_ns == 40 * MS
    assert gate.judge(7, GOOD).accepted
    assert gate.judge(8, superseded).verdict is Verdict.DUPLICATE


def test_both_bounds_are_inclusive():
    """Exactly tau_max and exactly age_max pass; one nanosecond more does not."""
    tight = GateSettings(250 * MS, 250 * MS)
    sent = replace(SENT, t_capture_ns=SENT.t1_ns)
    edge = stamps_of(sent, 125 * MS, 0, 125 * MS)
    assert judge(edge, sent, None, tight).accepted
    late = replace(edge, t4_ns=edge.t4_ns + 1)
    assert judge(late, sent, None, tight).verdict is Verdict.NETWORK_DELAY


def test_a_forged_result_does_not_use_up_the_frame():
    """After results that anybody could have made up, the true one is still accepted."""
    gate = SentFrames(SETTINGS)
    gate.add(replace(SENT, acknowledged_by=None))
    assert gate.judge(7, GOOD).verdict is Verdict.NOT_ACKNOWLEDGED
    assert gate.acknowledge(7, "w1", 42)
    assert gate.judge(7, replace(GOOD, worker_boot_id=1)).verdict is Verdict.WRONG_WORKER
    assert gate.judge(7, replace(GOOD, t1_ns=0)).verdict is Verdict.ECHO_MISMATCH
    assert gate.judge(7, GOOD).accepted
    assert gate.judge(7, GOOD).verdict is Verdict.DUPLICATE


def test_a_result_whose_ack_was_lost_counts_if_that_start_acknowledged_another_frame():
    """One lost datagram costs no measurement; another start of the worker still has to ack."""
    later = replace(SENT, sequence=8, t_capture_ns=SENT.t_capture_ns + 33 * MS)
    for boot_id, verdict in ((42, Verdict.ACCEPTED), (99, Verdict.WRONG_WORKER)):
        gate = SentFrames(SETTINGS)
        for sent in (SENT, later):
            gate.add(replace(sent, acknowledged_by=None))
        assert gate.acknowledge(7, "w1", boot_id)
        unacknowledged = replace(GOOD, t_capture_ns=later.t_capture_ns)
        assert gate.judge(8, unacknowledged).verdict is verdict


def test_the_first_acknowledgement_stands_and_only_from_the_worker_that_was_asked():
    """A restarted worker's late ack cannot take over a frame that another start acknowledged."""
    gate = SentFrames(SETTINGS)
    gate.add(replace(SENT, acknowledged_by=None))
    assert not gate.acknowledge(7, "w2", 42)
    assert gate.acknowledge(7, "w1", 42)
    assert gate.acknowledge(7, "w1", 99)
    assert gate.judge(7, replace(GOOD, worker_boot_id=99)).verdict is Verdict.WRONG_WORKER


def test_memory_is_bounded_and_forgets_the_oldest():
    """A frame pushed out counts as never sent."""
    gate = SentFrames(SETTINGS, capacity=3)
    for sequence in range(10):
        gate.add(replace(SENT, sequence=sequence))
    assert len(gate) == 3
    assert gate.judge(6, GOOD).verdict is Verdict.NEVER_SENT
    assert gate.judge(7, GOOD).accepted


def copied() -> SentFrames:
    """Frame 7 went to w1, and 5 ms later to w2; both acknowledged it."""
    gate = SentFrames(SETTINGS)
    gate.add(replace(SENT, acknowledged_by=None))
    gate.add(replace(SENT, worker="w2", t1_ns=SENT.t1_ns + 5 * MS, acknowledged_by=None))
    assert gate.acknowledge(7, "w1", 42)
    assert gate.acknowledge(7, "w2", 43)
    return gate


OTHER = replace(GOOD, worker="w2", worker_boot_id=43, t1_ns=GOOD.t1_ns + 5 * MS)
"""The second worker's answer: it took no longer, and echoes its own copy's t1."""


def test_the_first_answer_to_a_frame_wins_and_the_other_is_counted_as_such():
    """Whichever comes first, and only one of the two is accepted."""
    for first, second in ((GOOD, OTHER), (OTHER, GOOD)):
        gate = copied()
        assert gate.judge(7, first).accepted
        assert gate.judge(7, second).verdict is Verdict.OTHER_COPY
        assert gate.judge(7, second).verdict is Verdict.DUPLICATE
        assert gate.unanswered(7) == frozenset()


def test_a_copy_that_was_not_looked_at_leaves_the_other_its_chance():
    """Dropped by one worker, found by the other."""
    gate = copied()
    assert gate.judge(7, GOOD, looked_at=False).verdict is Verdict.NOT_LOOKED_AT
    assert gate.unanswered(7) == {"w2"}
    assert gate.judge(7, OTHER).accepted


def test_each_copy_is_judged_by_its_own_stamps_and_its_own_worker():
    """w2 cannot answer with the stamp of the copy that went to w1, nor under w1's boot id."""
    gate = copied()
    assert gate.judge(7, replace(OTHER, t1_ns=GOOD.t1_ns)).verdict is Verdict.ECHO_MISMATCH
    assert gate.judge(7, replace(OTHER, worker_boot_id=42)).verdict is Verdict.WRONG_WORKER
    assert gate.judge(7, replace(OTHER, worker="w3")).verdict is Verdict.WRONG_WORKER
    assert gate.judge(7, OTHER).network_delay_ns == 35 * MS


@given(durations_ns, durations_ns, durations_ns, st.integers(-HOUR, HOUR), st.booleans())
def test_copies_are_accepted_or_not_whatever_the_two_workers_clocks_say(
    d1, service, d2, offset_ns, first_is_w1
):
    """The pair of verdicts is the same with the second worker an hour off."""

    def verdicts(second_offset_ns: int) -> list[Verdict]:
        gate = copied()
        copy = replace(SENT, worker="w2", t1_ns=SENT.t1_ns + 5 * MS)
        second = stamps_of(copy, d1, service, d2, second_offset_ns)
        second = replace(second, worker="w2", worker_boot_id=43)
        answers = [GOOD, second] if first_is_w1 else [second, GOOD]
        return [gate.judge(7, answer).verdict for answer in answers]

    assert verdicts(offset_ns) == verdicts(0)


@pytest.mark.parametrize(("tau", "age"), [(0, 1), (-1, 5), (10, 9)])
def test_bounds_that_make_no_sense_are_refused(tau, age):
    """tau_max is positive and lies within age_max."""
    with pytest.raises(ValueError, match="tau_max"):
        GateSettings(tau, age)
