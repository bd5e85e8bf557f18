"""The drone's memory of what it sent: bounded, and the only source of t1 for the gate."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace

from drone_client.gate import (
    GateSettings,
    Judgement,
    ResultStamps,
    SentFrame,
    judge,
)

REMEMBERED_FRAMES = 512
"""17 s at 30 Hz: longer than any age_max, short enough to bound memory."""


class SentFrames:
    """Frames under way and lately answered, and the newest accepted capture. Not thread-safe."""

    def __init__(self, settings: GateSettings, capacity: int = REMEMBERED_FRAMES) -> None:
        self._settings = settings
        self._capacity = capacity
        self._frames: OrderedDict[int, SentFrame] = OrderedDict()
        self._last_accepted_capture_ns: int | None = None

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, frame: SentFrame) -> None:
        """Remember a frame that is about to be sent; the oldest is forgotten when full."""
        self._frames[frame.sequence] = frame
        while len(self._frames) > self._capacity:
            self._frames.popitem(last=False)

    def acknowledge(self, sequence: int, worker: str, worker_boot_id: int) -> bool:
        """Note who acknowledged a frame; the first one stands. False: not a frame of ours."""
        sent = self._frames.get(sequence)
        if sent is None or sent.worker != worker:
            return False
        if sent.acknowledged_by is None:
            self._frames[sequence] = replace(sent, acknowledged_by=worker_boot_id)
        return True

    def judge(self, sequence: int, stamps: ResultStamps, *, looked_at: bool = True) -> Judgement:
        """Judge a result. The first one that is truly this frame's answer closes the frame."""
        sent = self._frames.get(sequence)
        last_ns = self._last_accepted_capture_ns
        judgement = judge(stamps, sent, last_ns, self._settings, looked_at=looked_at)
        if sent is not None and judgement.verdict.settles_frame:
            self._frames[sequence] = replace(sent, answered=True)
        if judgement.accepted:
            self._last_accepted_capture_ns = stamps.t_capture_ns
        return judgement
