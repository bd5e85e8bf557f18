"""One direction of the link, pure: from the time and the size of a packet to when it comes out.

The order is that of a radio: a queue, the line's serial rate, then the air, where it may be lost
(and has used the rate up all the same), then the delay with its jitter.
"""

from __future__ import annotations

import math
from enum import IntEnum
from random import Random

from link_emulator.bottleneck import Bottleneck
from link_emulator.impairments import Impairments
from link_emulator.loss import make_loss

MS = 1_000_000


class Drop(IntEnum):
    """Why a packet does not come out; negative, so that none is a time."""

    QUEUE_FULL = -1
    LOST = -2
    CUT = -3


class Path:
    """Decides about packets in the order in which they come.

    Args:
        impairments: what the link does.
        seed: the same seed, times and sizes give the same answers.
        start_ns: from when planned cuts are counted; the clock is the caller's and monotonic.
    """

    def __init__(self, impairments: Impairments, seed: int = 0, start_ns: int = 0) -> None:
        self._rng = Random(seed)
        self._start_ns = start_ns
        self._last_ns = 0
        self._line = Bottleneck(None, None)
        self._set(impairments)
        self._loss = make_loss(impairments.loss, impairments.burst, self._rng)

    @property
    def impairments(self) -> Impairments:
        """What the link does at present."""
        return self._impairments

    def change(self, impairments: Impairments) -> None:
        """Do something else from now on; what is under way keeps its time of release."""
        before = self._impairments
        self._set(impairments)
        if (before.loss, before.burst) != (impairments.loss, impairments.burst):
            self._loss = make_loss(impairments.loss, impairments.burst, self._rng)

    def offer(self, now_ns: int, size_bytes: int) -> int:
        """A packet enters.

        Args:
            now_ns: caller's clock, never less than before.
            size_bytes: of the whole packet.

        Returns:
            When it comes out [ns], or a ``Drop``.
        """
        if self.is_cut(now_ns):
            return Drop.CUT
        through_ns = self._line.offer(now_ns, size_bytes)
        if through_ns < 0:
            return Drop.QUEUE_FULL
        if self._loss.lost(now_ns):
            return Drop.LOST
        # Up, so that the rate is never exceeded by a rounding
        release_ns = math.ceil(through_ns) + self._delay_ns
        if self._jitter_ns:
            release_ns += int(self._rng.random() * self._jitter_ns)
        if not self._reorder and release_ns < self._last_ns:
            release_ns = self._last_ns
        self._last_ns = release_ns
        return Drop.CUT if self._cuts_ns and self.is_cut(release_ns) else release_ns

    def is_cut(self, at_ns: int) -> bool:
        """Whether nothing gets through at this time."""
        if self._cut:
            return True
        return any(first <= at_ns - self._start_ns < last for first, last in self._cuts_ns)

    def backlog_bytes(self, now_ns: int) -> float:
        """What waits for the line or is on it."""
        return self._line.backlog_bytes(now_ns)

    def _set(self, impairments: Impairments) -> None:
        i = self._impairments = impairments
        rate_bit_s = None if i.rate_mbit is None else i.rate_mbit * 1e6
        queue_bytes: float | None = i.queue_bytes
        if queue_bytes is None and rate_bit_s is not None:
            queue_bytes = i.queue_ms * 1e-3 * rate_bit_s / 8
        free_ns = self._line.free_ns
        self._line = Bottleneck(rate_bit_s, queue_bytes)
        if rate_bit_s is not None:
            self._line.waits_until(free_ns)
        self._delay_ns = round(i.delay_ms * MS)
        self._jitter_ns = round(i.jitter_ms * MS)
        self._reorder = i.reorder
        self._cut = i.cut
        self._cuts_ns = tuple((round(a * MS), round(b * MS)) for a, b in i.cuts_ms)
