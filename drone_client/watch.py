"""The watch over the workers: whom the next frame goes to, and what has to be sent besides.

Puts together what is known of each worker (``roster``), its probes (``prober``) and the frames
that wait for an answer (``under_way``), and says on every tick what is to be done about it. The
lease of a link would notice a hung worker after seconds; this notices it on the scale of tau_max.

Pure: time is an argument, and what is to be sent is returned. Not thread-safe.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from drone_client.clock_offset import OffsetEstimate
from drone_client.prober import Prober
from drone_client.roster import Roster
from drone_client.under_way import FramesUnderWay, UnderWay
from rgbd_wire.messages import Outcome, Status
from rgbd_wire.probe import Probe

MIN_ACK_WAIT_NS = 60_000_000
"""An ack is never called missing earlier: what a busy machine may take."""


_NO_HELP = frozenset({Outcome.OVERLOADED, Outcome.FAILED, Outcome.DROPPED})
"""Answers that come fast and say nothing: another worker may do better."""


class Why(StrEnum):
    """Why a frame gets a second copy."""

    HAND_OVER = "hand_over"
    """Its worker is gone or suspect."""
    HEDGE = "hedge"
    """Its answer is late."""


@dataclass(frozen=True, slots=True)
class Copy:
    """A second copy to send."""

    frame: UnderWay
    worker: str
    why: Why


@dataclass(slots=True)
class Actions:
    """What a tick asks for."""

    probes: list[tuple[str, Probe]] = field(default_factory=list)
    copies: list[Copy] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    """Sequences whose workers will not acknowledge them: their slots are free."""
    unheard: list[str] = field(default_factory=list)
    """Workers that became suspect: the link may try another way to them."""
    events: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    """For the ledger."""


class WorkerWatch:
    """Decides about workers and copies; executed by the uplink."""

    def __init__(self, drone: str, boot_id: int, age_max_ns: int, *, hedge: bool) -> None:
        self._hedge = hedge
        self._roster = Roster(drone)
        self._prober = Prober(boot_id)
        self._frames = FramesUnderWay(age_max_ns)
        self._missed_probes: dict[str, int] = {}
        self._worker: str | None = None
        self._at_tick: str | None = None
        """Whom frames went to at the last tick: one that was left since then is handed over."""
        self._events: list[tuple[str, dict[str, Any]]] = []

    @property
    def worker(self) -> str | None:
        """Whom frames go to."""
        return self._worker

    def estimate(self, worker: str) -> OffsetEstimate | None:
        """Clock offset and round trips of a worker, by its probes."""
        return self._prober.estimate(worker)

    def round_trip_ns(self, worker: str) -> int:
        """Shortest round trip of a probe lately; 0: unknown."""
        estimate = self._prober.estimate(worker)
        return 0 if estimate is None else estimate.rtt_min_ns

    def standings(self) -> dict[str, str]:
        """What this drone thinks of its workers."""
        return self._roster.standings()

    def choose(self, now_ns: int, live: Collection[str]) -> str | None:
        """Whom a frame that leaves now goes to; None: nobody is there."""
        self._roster.see(live)
        worker = self._roster.choose(now_ns)
        if worker != self._worker:
            why = None if self._worker is None else self._roster.standing(self._worker).value
            details = {"before": self._worker, "now": worker, "live": sorted(live)}
            # One that is still willing was left for a much better one
            self._events.append(("worker", details | {"why": why, "standings": self.standings()}))
            self._worker = worker
        return worker

    def sent(self, frame: UnderWay) -> None:
        """A frame has left."""
        self._frames.add(frame)

    def heard(self, sequence: int, worker: str, t_ns: int) -> None:
        """An ack or a result came."""
        frame = self._frames.get(sequence)
        if frame is not None and frame.acked_by is None and worker == frame.workers[-1]:
            frame.acked_by = worker
        self._roster.replied(worker, t_ns)

    def answered(
        self, sequence: int, worker: str, t4_ns: int, outcome: Outcome, *, settled: bool
    ) -> None:
        """A result came, after ``heard``."""
        if outcome in _NO_HELP:
            if self._roster.refused(worker, t4_ns):
                details = {"worker": worker, "why": f"{outcome.value}, again and again"}
                self._events.append(("suspect", details))
        else:
            self._roster.answered(worker)
        if settled:
            self._frames.answered(sequence, t4_ns, looked_at=outcome.looked_at)

    def drains(self, worker: str) -> None:
        """A result says that its worker is about to stop."""
        self._roster.drains(worker)

    @property
    def same_name(self) -> list[str]:
        """Names under which two workers are there at once."""
        return self._roster.same_name

    def echo(self, probe: Probe, t4_ns: int) -> None:
        """A probe came back."""
        worker = self._prober.echo(probe, t4_ns)
        if worker is not None:
            self._missed_probes[worker] = 0
            self._roster.replied(worker, t4_ns, self.round_trip_ns(worker))

    def take_status(self, status: Status) -> None:
        """A worker says how it is."""
        self._roster.take_status(status)

    def hopeless(self, workers: Collection[str]) -> bool:
        """Whether none of these workers will answer."""
        return not any(self._roster.keeps_its_frames(w) for w in workers)

    def tick(self, now_ns: int, live: Collection[str]) -> Actions:
        """Look at everything: misses, hand-over, hedging, probes."""
        actions = Actions()
        self._roster.see(live)
        self._count_misses(now_ns, live, actions)
        before = self._at_tick
        self._at_tick = worker = self.choose(now_ns, live)
        if worker != before and before is not None:
            self._hand_over(now_ns, before, actions)
        elif self._hedge:
            self._hedge_newest(now_ns, actions)
        actions.probes = self._prober.due(now_ns, live)
        actions.events, self._events = self._events, []
        return actions

    def _count_misses(self, now_ns: int, live: Collection[str], actions: Actions) -> None:
        suspects = []
        for frame in self._frames.missing_acks(now_ns):
            worker = frame.workers[-1]
            self._events.append(("ack_missed", {"sequence": frame.sequence, "worker": worker}))
            if self._roster.missed(worker):
                suspects.append((worker, "no replies"))
        for frame in self._frames.too_old(now_ns):
            if frame.acked_by is not None and self._roster.overdue(frame.acked_by, now_ns):
                suspects.append((frame.acked_by, "acks but no results"))
        for worker in live:
            missed = self._prober.missed(worker, now_ns)
            for _ in range(missed - self._missed_probes.get(worker, 0)):
                if self._roster.missed(worker):
                    suspects.append((worker, "no replies"))
            self._missed_probes[worker] = missed
        for worker in [w for w in self._missed_probes if w not in live]:
            del self._missed_probes[worker]
        for worker, why in suspects:
            self._events.append(("suspect", {"worker": worker, "why": why}))
            actions.unheard.append(worker)

    def _hand_over(self, now_ns: int, before: str, actions: Actions) -> None:
        """Free what the old worker will not acknowledge, and send the newest of it again.

        A draining worker answers what it has: nothing is lost.
        """
        if self._roster.keeps_its_frames(before):
            return
        mine = self._frames.of(before)
        actions.lost = [f.sequence for f in mine]
        if mine and self._worker is not None:
            self._copy(mine[-1], self._worker, Why.HAND_OVER, now_ns, actions)

    def _hedge_newest(self, now_ns: int, actions: Actions) -> None:
        other = self._roster.runner_up()
        if other is None:
            return
        frame = self._frames.at_risk(now_ns, self._roster.expected_delay_ns(other))
        if frame is not None:
            self._copy(frame, other, Why.HEDGE, now_ns, actions)

    def _copy(self, frame: UnderWay, worker: str, why: Why, now_ns: int, actions: Actions) -> None:
        if frame.has_copy or self._frames.remaining_ns(frame, now_ns) <= 0:
            return
        frame.workers.append(worker)
        frame.acked_by, frame.missed = None, False
        frame.ack_due_ns = now_ns + MIN_ACK_WAIT_NS + self.round_trip_ns(worker)
        actions.copies.append(Copy(frame, worker, why))
        details = {"sequence": frame.sequence, "worker": worker, "why": why.value}
        self._events.append(("copy", details))
