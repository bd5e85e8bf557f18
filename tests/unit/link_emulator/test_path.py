"""One direction of the link as a function of times and sizes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from link_emulator.impairments import Impairments
from link_emulator.path import Drop, Path

MS = 1_000_000
packets = st.lists(
    st.tuples(st.integers(0, 5 * MS), st.integers(20, 1500)), min_size=1, max_size=200
)
"""Gap to the packet before [ns] and size [bytes]."""
links = st.builds(
    Impairments,
    rate_mbit=st.none() | st.floats(0.5, 1000),
    queue_ms=st.floats(0, 200),
    delay_ms=st.floats(0, 50),
    jitter_ms=st.floats(0, 20),
    loss=st.sampled_from([0.0, 0.05, 0.3]),
    cuts_ms=st.sampled_from([(), ((3.0, 20.0),)]),
)


def run(path: Path, offered: list[tuple[int, int]]) -> list[tuple[int, int, int]]:
    """Each packet's arrival, size, and release or drop."""
    now_ns = 0
    out = []
    for gap_ns, size_bytes in offered:
        now_ns += gap_ns
        out.append((now_ns, size_bytes, path.offer(now_ns, size_bytes)))
    return out


@given(links, packets, st.integers(0, 9))
def test_order_is_kept_and_nothing_is_early(
    link: Impairments, offered: list[tuple[int, int]], seed: int
) -> None:
    """Unless reordering is asked for, packets come out as they went in, after the delay."""
    passed = [(now, out) for now, _, out in run(Path(link, seed), offered) if out >= 0]
    assert all(a[1] <= b[1] for a, b in zip(passed, passed[1:], strict=False))
    assert all(out >= now + round(link.delay_ms * MS) for now, out in passed)


@given(st.floats(0.5, 1000), st.floats(0, 200), packets)
def test_rate_is_exceeded_over_no_window(
    rate_mbit: float, queue_ms: float, offered: list[tuple[int, int]]
) -> None:
    """Between the release of any packet and any later one, the line had time for all after it."""
    path = Path(Impairments(rate_mbit=rate_mbit, queue_ms=queue_ms, delay_ms=3))
    passed = [(out, size) for _, size, out in run(path, offered) if out >= 0]
    for first in range(len(passed)):
        sent_bits = 0
        for last in range(first + 1, len(passed)):
            sent_bits += 8 * passed[last][1]
            window_ns = passed[last][0] - passed[first][0]
            assert sent_bits <= rate_mbit * 1e-3 * (window_ns + 1) * (1 + 1e-9)


@given(st.floats(0.5, 100), st.integers(0, 30_000), packets)
def test_queue_never_holds_more_than_its_bound(
    rate_mbit: float, queue_bytes: int, offered: list[tuple[int, int]]
) -> None:
    """A packet that would not fit is dropped; one that finds the line free is always taken."""
    path = Path(Impairments(rate_mbit=rate_mbit, queue_bytes=queue_bytes))
    now_ns = 0
    for gap_ns, size_bytes in offered:
        now_ns += gap_ns
        before = path.backlog_bytes(now_ns)
        out = path.offer(now_ns, size_bytes)
        after = path.backlog_bytes(now_ns)
        if out == Drop.QUEUE_FULL:
            assert before > 0
            assert before + size_bytes > queue_bytes - 1
            assert after == before
        else:
            assert after <= max(queue_bytes, size_bytes) + 1e-6
        assert before <= max(queue_bytes, 1500) + 1e-6


@given(links, packets, st.integers(0, 9))
def test_same_seed_gives_the_same_link(
    link: Impairments, offered: list[tuple[int, int]], seed: int
) -> None:
    """Chance comes from the seed alone."""
    assert run(Path(link, seed), offered) == run(Path(link, seed), offered)


def test_queue_in_ms_is_the_time_to_drain() -> None:
    """At 8 Mbit/s a queue of 10 ms holds ten packets of 1000 bytes."""
    path = Path(Impairments(rate_mbit=8, queue_ms=10))
    results = [path.offer(0, 1000) for _ in range(20)]
    assert results[:10] == [MS * (n + 1) for n in range(10)]
    assert results[10:] == [Drop.QUEUE_FULL] * 10


def test_lost_packets_have_used_the_rate_up() -> None:
    """Loss is on the air, behind the line: what gets through comes when it would have anyway."""
    loses = Path(Impairments(rate_mbit=8, queue_ms=1000, loss=0.5), seed=1)
    clean = Path(Impairments(rate_mbit=8, queue_ms=1000))
    for _ in range(100):
        lossy, plain = loses.offer(0, 1000), clean.offer(0, 1000)
        assert lossy in (Drop.LOST, plain)


def test_jitter_reorders_on_request_alone() -> None:
    """With a jitter larger than the gaps, some packet overtakes another if it may."""
    link = Impairments(jitter_ms=20, reorder=True)
    offered = [(MS, 100)] * 100
    free = [out for *_, out in run(Path(link), offered)]
    kept = [out for *_, out in run(Path(replace(link, reorder=False)), offered)]
    assert free != sorted(free)
    assert kept == sorted(kept)
    assert max(out - MS * (n + 1) for n, out in enumerate(free)) <= 20 * MS


def test_planned_cut_drops_what_enters_and_what_would_leave() -> None:
    """A cut from 10 to 20 ms: also a packet that is on its way when it begins is lost."""
    path = Path(Impairments(delay_ms=5, cuts_ms=((10, 20),)), start_ns=1000 * MS)
    at = {ms: path.offer((1000 + ms) * MS, 100) for ms in (4, 6, 12, 19, 20)}
    assert at == {
        4: 1009 * MS,
        6: Drop.CUT,
        12: Drop.CUT,
        19: Drop.CUT,
        20: 1025 * MS,
    }


def test_change_takes_over_what_waits() -> None:
    """A slower rate holds for what comes now, behind what the line had still to send."""
    path = Path(Impairments(rate_mbit=8, queue_ms=100))
    assert [path.offer(0, 1000) for _ in range(3)][-1] == 3 * MS
    path.change(Impairments(rate_mbit=4, queue_ms=100))
    assert path.offer(0, 1000) == 5 * MS


def test_change_of_the_delay_keeps_the_order() -> None:
    """A packet of a shorter delay does not overtake one that is under way."""
    path = Path(Impairments(delay_ms=50))
    first = path.offer(0, 100)
    path.change(Impairments(delay_ms=1))
    assert path.offer(MS, 100) == first


def test_cut_and_heal_at_once() -> None:
    """Live, without a plan."""
    path = Path(Impairments())
    path.change(Impairments(cut=True))
    assert path.offer(5, 100) == Drop.CUT
    assert path.is_cut(6)
    path.change(Impairments())
    assert path.offer(7, 100) == 7


@pytest.mark.parametrize("drop", list(Drop))
def test_no_drop_is_a_time(drop: Drop) -> None:
    """One number tells both, so they must not overlap."""
    assert drop < 0
