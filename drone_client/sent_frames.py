"""The drone's memory of what it sent: bounded, and the only source of t1 for the gate."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field, replace

from drone_client.gate import (
    GateSettings,
    Judgement,
    ResultStamps,
    SentFrame,
    Verdict,
    judge,
)

REMEMBERED_FRAMES = 512
"""17 s at 30 Hz: longer than any age_max, short enough to bound memory."""


@dataclass(slots=True)
class _Frame:
    """A frame's copies by worker; one of them is accepted at most."""

    copies: dict[str, SentFrame] = field(default_factory=dict)
    accepted: bool = False


class SentFrames:
    """Frames under way and lately answered, and the newest accepted capture. Not thread-safe."""

    def __init__(self, settings: GateSettings, capacity: int = REMEMBERED_FRAMES) -> None:
        self._settings = settings
        self._capacity = capacity
        self._frames: OrderedDict[int, _Frame] = OrderedDict()
        self._last_accepted_capture_ns: int | None = None
        self._boot_ids: dict[str, int] = {}
        """Of each worker, the start that acknowledged a frame last."""

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, copy: SentFrame) -> None:
        """Remember a copy that is about to be sent; the oldest frame is forgotten when full.

        A worker that is sent the same frame again answers for the newer copy.
        """
        frame = self._frames.setdefault(copy.sequence, _Frame())
        frame.copies[copy.worker] = copy
        while len(self._frames) > self._capacity:
            self._frames.popitem(last=False)

    def acknowledge(self, sequence: int, worker: str, worker_boot_id: int) -> bool:
        """Note who acknowledged a frame; the first one stands. False: not a frame of ours.

        A result whose own ack was lost is taken as one if the same start of the worker
        acknowledged another frame last.
        """
        frame = self._frames.get(sequence)
        if frame is None or (sent := frame.copies.get(worker)) is None:
            return False
        self._boot_ids[worker] = worker_boot_id
        if sent.acknowledged_by is None:
            frame.copies[worker] = replace(sent, acknowledged_by=worker_boot_id)
        return True

    def judge(self, sequence: int, stamps: ResultStamps, *, looked_at: bool = True) -> Judgement:
        """Judge a result. The first one that is truly a copy's answer closes that copy."""
        frame = self._frames.get(sequence)
        if frame is None:
            return Judgement(Verdict.NEVER_SENT)
        sent = frame.copies.get(stamps.worker)
        if sent is None:
            return Judgement(Verdict.WRONG_WORKER)
        if sent.acknowledged_by is None:
            sent = replace(sent, acknowledged_by=self._boot_ids.get(stamps.worker))
        judgement = judge(
            stamps,
            sent,
            self._last_accepted_capture_ns,
            self._settings,
            looked_at=looked_at,
            other_copy_accepted=frame.accepted,
        )
        if judgement.verdict.settles_frame:
            frame.copies[stamps.worker] = replace(sent, answered=True)
        if judgement.accepted:
            frame.accepted = True
            self._last_accepted_capture_ns = stamps.t_capture_ns
        return judgement

    def unanswered(self, sequence: int) -> frozenset[str]:
        """Workers that a frame went to and that have not answered it yet."""
        frame = self._frames.get(sequence)
        if frame is None:
            return frozenset()
        return frozenset(w for w, copy in frame.copies.items() if not copy.answered)
