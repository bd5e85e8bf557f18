"""Probes: spread out, matched to their workers, and missed when they do not come back."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from drone_client.prober import MAX_REMEMBERED, Prober, ProberSettings
from rgbd_wire.probe import Probe

MS = 1_000_000
S = 1_000_000_000
BOOT_ID = 42
PERIOD_NS = ProberSettings().period_ns
SHIFT_NS = 3600 * S
"""Worker's clock minus drone's clock."""


def answer(probe: Probe, d1_ns: int = 5 * MS, worker_boot_id: int = 1) -> Probe:
    t2_ns = probe.t1_ns + d1_ns + SHIFT_NS
    return replace(probe, t2_ns=t2_ns, t3_ns=t2_ns + 1000, worker_boot_id=worker_boot_id)


def run(prober: Prober, begin_ns: int, end_ns: int, workers, rtt_ns=10 * MS, tick_ns=2 * MS):
    """Tick; echoes of the workers in ``workers`` come after ``rtt_ns``, unless that is None."""
    on_the_way: list[tuple[int, Probe]] = []
    for now_ns in range(begin_ns, end_ns, tick_ns):
        for t4_ns, probe in [e for e in on_the_way if e[0] <= now_ns]:
            on_the_way.remove((t4_ns, probe))
            prober.echo(answer(probe, rtt_ns // 2), t4_ns)
        for worker, probe in prober.due(now_ns, workers):
            if rtt_ns is not None:
                on_the_way.append((now_ns + rtt_ns, probe))
            yield now_ns, worker, probe
        for worker in workers:
            prober.missed(worker, now_ns)


@given(st.integers(1, 12), st.integers(0, 10**12))
def test_every_worker_is_probed_at_the_streams_rate(n, begin_ns):
    """15 a second each, whatever their number; sequences are never used twice."""
    workers = [f"w{i}" for i in range(n)]
    sent = list(run(Prober(BOOT_ID), begin_ns, begin_ns + 2 * S, workers))
    counts = Counter(worker for _, worker, _ in sent)
    assert all(29 <= counts[worker] <= 31 for worker in workers)
    assert len({probe.sequence for _, _, probe in sent}) == len(sent)
    assert all(probe.boot_id == BOOT_ID and probe.t1_ns == t for t, _, probe in sent)


@given(st.integers(2, 6))
def test_workers_are_not_probed_in_a_burst(n):
    """All found at once: their probes are spread over the period."""
    times = [t for t, _, _ in run(Prober(BOOT_ID), 0, S, [f"w{i}" for i in range(n)])]
    gaps = [b - a for a, b in zip(times, times[1:], strict=False)]
    assert min(gaps) >= PERIOD_NS * 0.3 / n


def test_what_was_due_while_nobody_asked_is_left_out():
    """A pause of a second is followed by one probe, not by fifteen."""
    prober = Prober(BOOT_ID)
    assert len(prober.due(0, ["w"])) == 1
    assert len(prober.due(S, ["w"])) == 1
    assert prober.due(S, ["w"]) == []


def test_an_echo_finds_its_worker_and_is_measured():
    """Round trip, offset and time-out of that worker alone."""
    prober = Prober(BOOT_ID)
    for _, worker, probe in list(run(prober, 0, PERIOD_NS, ["a", "b"], rtt_ns=None)):
        if worker == "a":
            assert prober.echo(answer(probe), probe.t1_ns + 10 * MS) == "a"
    estimate = prober.estimate("a")
    assert abs(estimate.offset_ns - SHIFT_NS) <= estimate.bound_ns
    assert estimate.rtt_min_ns == 10 * MS - 1000
    assert prober.srtt_ns("a") == 10 * MS
    assert prober.estimate("b") is prober.srtt_ns("b") is None
    assert prober.estimate("nobody") is None
    assert prober.echoes == 1


def test_what_is_no_echo_of_ours_is_counted():
    """Twice, of another start, never asked for, with another t1, of a worker that is gone."""
    prober = Prober(BOOT_ID)
    ((_, probe),) = prober.due(0, ["w"])
    echo = answer(probe)
    assert prober.echo(replace(echo, t1_ns=1), 10 * MS) is None
    assert prober.echo(replace(echo, boot_id=BOOT_ID + 1), 10 * MS) is None
    assert prober.echo(replace(echo, sequence=77), 10 * MS) is None
    assert prober.estimate("w") is None
    assert prober.echo(echo, 10 * MS) == "w"
    assert prober.echo(echo, 11 * MS) is None
    prober.due(20 * MS, [])
    assert prober.echo(echo, 21 * MS) is None
    assert (prober.echoes, prober.duplicates, prober.foreign, prober.unknown) == (1, 1, 1, 3)


def test_a_silent_worker_is_missed_probe_by_probe_and_an_echo_ends_it():
    """The count only grows until something comes back, and then it is zero."""
    prober = Prober(BOOT_ID)
    sent = [probe for _, _, probe in run(prober, 0, S, ["w"], rtt_ns=None)]
    seen = [prober.missed("w", S + t) for t in range(0, 200 * MS, MS)]
    assert seen == sorted(seen)
    assert seen[-1] == len(sent) == prober.timed_out
    assert prober.echo(answer(sent[-1]), S + 200 * MS) == "w"
    assert prober.missed("w", S + 200 * MS) == 0
    assert prober.missed("nobody", 0) == 0


def test_three_misses_take_less_than_three_hundred_milliseconds():
    """A worker at 10 ms that falls silent: time-out plus two periods."""
    prober = Prober(BOOT_ID)
    list(run(prober, 0, S, ["w"]))
    for now_ns, _, _ in run(prober, S, 2 * S, ["w"], rtt_ns=None):
        if prober.missed("w", now_ns) >= 3:
            break
    assert now_ns - S < 300 * MS


@given(st.integers(0, 450 * MS))
def test_a_link_that_is_slow_but_steady_misses_nothing(rtt_ns):
    """After its first few echoes: the time-out is never under the round trip."""
    prober = Prober(BOOT_ID)
    list(run(prober, 0, 3 * S, ["w"], rtt_ns))
    before = prober.timed_out
    list(run(prober, 3 * S, 4 * S, ["w"], rtt_ns))
    # The second run begins with the echoes of the first lost: only these are missed
    assert prober.timed_out - before <= rtt_ns // PERIOD_NS + 1
    assert rtt_ns <= prober.timeout_ns("w") <= 500 * MS


def test_time_outs_stay_within_their_limits():
    """50 ms for a fast link, 100 ms while nothing is known."""
    prober = Prober(BOOT_ID)
    assert prober.timeout_ns("w") == 100 * MS
    list(run(prober, 0, S, ["w"], rtt_ns=2 * MS))
    assert prober.timeout_ns("w") == 50 * MS


def test_an_overtaken_probe_is_no_silence():
    """The echo of a later one came: the way is open, whatever became of the earlier."""
    prober = Prober(BOOT_ID)
    sent = [prober.due(i * PERIOD_NS, ["w"])[0][1] for i in range(3)]
    assert prober.echo(answer(sent[2]), sent[2].t1_ns + 10 * MS) == "w"
    assert prober.missed("w", S) == 0
    assert prober.echo(answer(sent[0]), sent[2].t1_ns + 11 * MS) == "w"


def test_a_restart_of_a_worker_is_seen():
    """Its clock starts afresh, and that is told."""
    prober = Prober(BOOT_ID)
    for now_ns, boot_id in ((0, 1), (PERIOD_NS, 2)):
        ((_, probe),) = prober.due(now_ns, ["w"])
        prober.echo(answer(probe, worker_boot_id=boot_id), now_ns + 10 * MS)
    assert prober.clock_events("w") == (1, 0, 0)
    assert prober.clock_events("nobody") == (0, 0, 0)


def test_memory_is_bounded():
    """A minute without an echo, and workers that come and go."""
    prober = Prober(BOOT_ID)
    list(run(prober, 0, 60 * S, ["w"], rtt_ns=None, tick_ns=30 * MS))
    assert len(prober._worker_of) <= MAX_REMEMBERED
    for i in range(100):
        prober.due(60 * S + i * S, [f"w{i}"])
        prober.due(60 * S + i * S + PERIOD_NS, [f"w{i}"])
    assert len(prober._worker_of) <= 2
    assert len(prober._workers) == 1
