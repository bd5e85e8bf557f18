"""Frames that were sent and whose answer is still of use: what a copy is made of.

A frame gets at most one more copy, to another worker: when its own is lost, or, on request, when
its answer is late enough to be at risk (hedging; Dean and Barroso, "The tail at scale", 2013).

Pure: time is an argument. Not thread-safe.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass

import numpy as np

from rgbd_wire.frame_codec import CompressedFrame

KEPT_FRAMES = 8
"""More than any window that makes sense; each holds its compressed pictures."""
ROUND_TRIPS = 64
HEDGE_QUANTILE = 0.9
"""Of the answers of late: a frame that is slower than so many of them is at risk."""
MIN_HEDGE_NS = 20_000_000
FEW_ROUND_TRIPS = 8
"""With fewer of them nothing is hedged: nobody knows what late means."""


@dataclass(slots=True, eq=False)
class UnderWay:
    """A frame that was sent, and to whom."""

    sequence: int
    compressed: CompressedFrame
    workers: list[str]
    """Who has a copy, the first one first."""
    t1_ns: int
    """When the first copy left, drone's clock."""
    ack_due_ns: int
    """When its ack, or else its result, counts as missed."""
    acked_by: str | None = None
    missed: bool = False
    """The missing ack was counted."""

    @property
    def t_capture_ns(self) -> int:
        """Drone's clock."""
        return self.compressed.frame.t_capture_ns

    @property
    def has_copy(self) -> bool:
        """It went to a second worker."""
        return len(self.workers) > 1


class FramesUnderWay:
    """The newest frames without an answer, and how long answers take."""

    def __init__(self, age_max_ns: int) -> None:
        self._age_max_ns = age_max_ns
        self._frames: OrderedDict[int, UnderWay] = OrderedDict()
        self._round_trips_ns: deque[int] = deque(maxlen=ROUND_TRIPS)

    def __len__(self) -> int:
        return len(self._frames)

    def get(self, sequence: int) -> UnderWay | None:
        """A frame that is still under way."""
        return self._frames.get(sequence)

    @property
    def newest(self) -> UnderWay | None:
        """The frame that left last."""
        return next(reversed(self._frames.values()), None)

    def add(self, frame: UnderWay) -> None:
        """A frame has left; the oldest is let go where there are too many."""
        self._frames[frame.sequence] = frame
        while len(self._frames) > KEPT_FRAMES:
            self._frames.popitem(last=False)

    def answered(self, sequence: int, t4_ns: int, *, looked_at: bool) -> None:
        """Its answer came: it is done with."""
        frame = self._frames.pop(sequence, None)
        if frame is not None and looked_at and not frame.has_copy:
            self._round_trips_ns.append(t4_ns - frame.t1_ns)

    def of(self, worker: str) -> list[UnderWay]:
        """Frames whose newest copy went to a worker, oldest first."""
        return [f for f in self._frames.values() if f.workers[-1] == worker]

    def missing_acks(self, now_ns: int) -> list[UnderWay]:
        """Frames whose ack is due and was not counted as missed yet; they count from now on."""
        late = [
            f
            for f in self._frames.values()
            if f.acked_by is None and not f.missed and now_ns >= f.ack_due_ns
        ]
        for frame in late:
            frame.missed = True
        return late

    def too_old(self, now_ns: int) -> list[UnderWay]:
        """Let go of the frames whose answer would be of no use any more."""
        old = [f for f in self._frames.values() if now_ns - f.t_capture_ns > self._age_max_ns]
        for frame in old:
            del self._frames[frame.sequence]
        return old

    def remaining_ns(self, frame: UnderWay, now_ns: int) -> int:
        """How long its answer is still of use."""
        return self._age_max_ns - (now_ns - frame.t_capture_ns)

    def at_risk(self, now_ns: int, other_delay_ns: int) -> UnderWay | None:
        """The newest frame, if its answer is late and another worker's could still come in time.

        Args:
            now_ns: drone's clock.
            other_delay_ns: how long the other worker is expected to take.
        """
        frame = self.newest
        if frame is None or frame.has_copy or len(self._round_trips_ns) < FEW_ROUND_TRIPS:
            return None
        usual_ns = float(np.quantile(self._round_trips_ns, HEDGE_QUANTILE))
        late = now_ns - frame.t1_ns > max(MIN_HEDGE_NS, usual_ns)
        return frame if late and self.remaining_ns(frame, now_ns) >= other_delay_ns else None
