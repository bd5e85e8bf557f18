"""Packets leave when they are due, in order, and every one is accounted for."""

from __future__ import annotations

from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from link_emulator.impairments import Impairments
from link_emulator.lane import NEVER_NS, Lane
from link_emulator.path import Path

MS = 1_000_000


@dataclass
class Far:
    """The far side, and a clock that each packet moves on."""

    now_ns: int = 0
    cost_ns: int = 0
    takes: bool = True
    got: list[tuple[int, bytes]] = field(default_factory=list)

    def emit(self, packet: bytes) -> bool:
        """Take a packet."""
        self.now_ns += self.cost_ns
        if self.takes:
            self.got.append((self.now_ns, packet))
        return self.takes

    def lane(self, impairments: Impairments) -> Lane[bytes]:
        """A lane to here."""
        return Lane(Path(impairments), self.emit, lambda: self.now_ns)


def test_packet_waits_for_its_time() -> None:
    """Not a nanosecond early; the lane says when to come back."""
    far = Far()
    lane = far.lane(Impairments(delay_ms=5))
    assert lane.next_ns == NEVER_NS
    lane.offer(b"a", 100, 0)
    assert lane.next_ns == 5 * MS
    assert lane.release(5 * MS - 1, 10) == 0
    far.now_ns = 5 * MS
    assert lane.release(5 * MS, 10) == 1
    assert far.got == [(5 * MS, b"a")]
    assert lane.next_ns == NEVER_NS


def test_release_error_is_what_the_clock_says_after_sending() -> None:
    """The second packet of a burst is later than the first, by what the first cost."""
    far = Far(now_ns=5 * MS, cost_ns=100_000)
    lane = far.lane(Impairments(delay_ms=5))
    for packet in (b"a", b"b"):
        lane.offer(packet, 100, 0)
    lane.release(5 * MS, 10)
    assert lane.errors.total == 2
    assert lane.errors.max_ns == 200_000


def test_one_turn_sends_no_more_than_it_may() -> None:
    """The rest is due at once, so the other side has its turn between."""
    far = Far()
    lane = far.lane(Impairments())
    for _ in range(5):
        lane.offer(b"x", 100, 0)
    assert lane.release(0, 3) == 3
    assert lane.next_ns == 0


def test_cut_takes_what_is_under_way() -> None:
    """A packet that is due while the link is cut is dropped, and said so."""
    far = Far()
    lane = far.lane(Impairments(delay_ms=5))
    lane.offer(b"a", 100, 0)
    lane.path.change(Impairments(delay_ms=5, cut=True))
    lane.release(5 * MS, 10)
    assert far.got == []
    assert lane.report().dropped["cut"] == 1


@given(st.lists(st.tuples(st.integers(0, MS), st.integers(20, 1500)), max_size=100), st.booleans())
def test_every_packet_is_accounted_for(offered: list[tuple[int, int]], takes: bool) -> None:
    """Passed, dropped by some reason, or waiting: together what was offered."""
    far = Far(takes=takes)
    lane = far.lane(Impairments(rate_mbit=20, queue_ms=2, delay_ms=1, loss=0.2))
    for gap_ns, size_bytes in offered:
        far.now_ns += gap_ns
        lane.offer(b"p", size_bytes, far.now_ns)
        lane.release(far.now_ns, 4)
    report = lane.report()
    assert report.passed == len(far.got) == lane.errors.total
    assert report.passed + sum(report.dropped.values()) + report.waiting == len(offered)
    lane.reset()
    assert lane.report().passed == sum(lane.report().dropped.values()) == 0
    assert lane.report().waiting == report.waiting
