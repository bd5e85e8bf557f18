"""The delay gate: which results may reach the controller (paper, Eq. "offloading"; docs/freshness).

``d1 + d2 = (t4 - t1) - (t3 - t2)`` is exact whatever the two clocks say: each bracket is a
difference on one clock. t1 and t4 are the drone's, t2 and t3 the worker's. The paper's condition
``d1 + d2 <= tau_max`` alone would hide queueing on the worker, and a worker that inflates
``t3 - t2`` would hide network delay; so the age since capture, which is the drone's own, is
bounded as well, and the worker's time must fit inside the drone's.

Pure: no clock, no thread, no I/O.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """What the gate says of a result; every one but ACCEPTED is a reason."""

    ACCEPTED = "accepted"
    NEVER_SENT = "never_sent"
    """Not a frame of ours, or of so long ago that it is forgotten."""
    DUPLICATE = "duplicate"
    ECHO_MISMATCH = "echo_mismatch"
    """The worker's echo of t_capture or t1 is not what was sent."""
    NOT_ACKNOWLEDGED = "not_acknowledged"
    WRONG_WORKER = "wrong_worker"
    """Not the worker, or not the same start of it, that acknowledged the frame."""
    IMPOSSIBLE_TIME = "impossible_time"
    """The worker's t3 - t2 is negative or longer than the whole round trip."""
    NOT_LOOKED_AT = "not_looked_at"
    """The worker never saw the picture (superseded, draining, ...): nothing to accept. Such an
    answer comes at once, and must not make the one before it, still at work, out of order."""
    NETWORK_DELAY = "network_delay"
    """d1 + d2 > tau_max: the paper's condition."""
    TOO_OLD = "too_old"
    """t4 - t_capture > age_max."""
    OTHER_COPY = "other_copy"
    """Its frame went to two workers, and the other one's answer was accepted first."""
    OUT_OF_ORDER = "out_of_order"
    """Captured no later than what was accepted last."""

    @property
    def settles_frame(self) -> bool:
        """The result is the frame's own answer, used or not.

        False where somebody else could have made it up: the true answer may still come.
        """
        return self not in _FOREIGN


_FOREIGN = frozenset(
    {
        Verdict.NEVER_SENT,
        Verdict.DUPLICATE,
        Verdict.ECHO_MISMATCH,
        Verdict.NOT_ACKNOWLEDGED,
        Verdict.WRONG_WORKER,
    }
)


@dataclass(frozen=True, slots=True)
class GateSettings:
    """The two bounds of the contract."""

    tau_max_ns: int
    """Largest d1 + d2, the time on the network, both ways."""
    age_max_ns: int
    """Largest age of a result when it arrives, since the middle of the exposure."""

    def __post_init__(self) -> None:
        if not 0 < self.tau_max_ns <= self.age_max_ns:
            raise ValueError(
                f"0 < tau_max ({self.tau_max_ns} ns) <= age_max ({self.age_max_ns} ns) must hold"
            )


@dataclass(frozen=True, slots=True)
class SentFrame:
    """What the drone remembers of a frame that it sent to a worker; stamps on the drone's clock.

    A frame that went to two workers (a hedge, or after a hand-over) has one of these for each: the
    copies left at different times, and each worker answers for its own.
    """

    sequence: int
    t_capture_ns: int
    t1_ns: int
    worker: str
    acknowledged_by: int | None = None
    """boot_id of the worker that acknowledged it."""
    answered: bool = False


@dataclass(frozen=True, slots=True)
class ResultStamps:
    """What the gate reads of a result."""

    worker: str
    worker_boot_id: int
    t_capture_ns: int
    t1_ns: int
    t2_ns: int
    """Worker's clock."""
    t3_ns: int
    """Worker's clock."""
    t4_ns: int
    """Result complete, drone's clock."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict and the times that it rests on; None where they would mean nothing."""

    verdict: Verdict
    network_delay_ns: int | None = None
    """d1 + d2."""
    age_ns: int | None = None
    """t4 - t_capture."""

    @property
    def accepted(self) -> bool:
        """The result may be used."""
        return self.verdict is Verdict.ACCEPTED


def network_delay_ns(s: ResultStamps) -> int:
    """d1 + d2 of a result: exact, and the same whatever the worker's clock says."""
    return (s.t4_ns - s.t1_ns) - (s.t3_ns - s.t2_ns)


def judge(
    stamps: ResultStamps,
    sent: SentFrame | None,
    last_accepted_capture_ns: int | None,
    settings: GateSettings,
    *,
    looked_at: bool = True,
    other_copy_accepted: bool = False,
) -> Judgement:
    """Judge one result.

    Args:
        stamps: the result's stamps, t4 on arrival.
        sent: what was sent under its sequence; None: nothing was.
        last_accepted_capture_ns: t_capture of the newest accepted result, drone's clock.
        settings: tau_max and age_max.
        looked_at: the worker has seen the picture, whatever it found.
        other_copy_accepted: another worker's answer to the same frame was accepted.
    """
    if sent is None:
        return Judgement(Verdict.NEVER_SENT)
    if (foreign := _foreign(stamps, sent)) is not None:
        return Judgement(foreign)

    age_ns = stamps.t4_ns - sent.t_capture_ns
    if not 0 <= stamps.t3_ns - stamps.t2_ns <= stamps.t4_ns - stamps.t1_ns:
        return Judgement(Verdict.IMPOSSIBLE_TIME, age_ns=age_ns)
    delay_ns = network_delay_ns(stamps)
    refused = _unusable(delay_ns, age_ns, settings, looked_at=looked_at)
    if refused is None and other_copy_accepted:
        refused = Verdict.OTHER_COPY
    if refused is None and (
        last_accepted_capture_ns is not None and sent.t_capture_ns <= last_accepted_capture_ns
    ):
        refused = Verdict.OUT_OF_ORDER
    return Judgement(refused or Verdict.ACCEPTED, delay_ns, age_ns)


def _unusable(
    delay_ns: int, age_ns: int, settings: GateSettings, *, looked_at: bool
) -> Verdict | None:
    """Why a result that is the frame's own says nothing that may be flown on; None: it does."""
    if not looked_at:
        return Verdict.NOT_LOOKED_AT
    if delay_ns > settings.tau_max_ns:
        return Verdict.NETWORK_DELAY
    if age_ns > settings.age_max_ns:
        return Verdict.TOO_OLD
    return None


def _foreign(stamps: ResultStamps, sent: SentFrame) -> Verdict | None:
    """Why a result is not this frame's own answer; None: it is."""
    if sent.answered:
        return Verdict.DUPLICATE
    if (stamps.t_capture_ns, stamps.t1_ns) != (sent.t_capture_ns, sent.t1_ns):
        return Verdict.ECHO_MISMATCH
    if sent.acknowledged_by is None:
        return Verdict.NOT_ACKNOWLEDGED
    if (stamps.worker, stamps.worker_boot_id) != (sent.worker, sent.acknowledged_by):
        return Verdict.WRONG_WORKER
    return None
