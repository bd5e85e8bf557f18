"""Probes to several workers: who is due one, which echo belongs to whom, and who leaves them out.

An echo is a sign of life and feeds the worker's ``ClockOffset``. It is matched by its sequence to
the worker that the probe went to: a duplicate, an echo of another start of this client or one that
nobody asked for is counted and changes nothing.

Pure: time is an argument, and the probes to send are returned. Not thread-safe.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

from drone_client.clock_offset import ClockOffset, Echo, OffsetEstimate
from rgbd_wire.probe import Probe
from rgbd_wire.streams import PROBE

GOLDEN_SHARE = 0.6180339887498949
"""Multiples of it, modulo one, never come close together: the phases of any number of workers."""
MAX_REMEMBERED = 64
"""Probes of one worker that a late echo still finds: four seconds."""


@dataclass(frozen=True, slots=True)
class ProberSettings:
    """How often, and how long an echo is waited for."""

    period_ns: int = round(1e9 / PROBE.rate_hz)
    """Between two probes to one worker."""
    round_trips: int = 4
    """An echo is missed after so many smoothed round trips ..."""
    min_timeout_ns: int = 50_000_000
    max_timeout_ns: int = 100_000_000
    """... held within these (the longest while nothing is known) ..."""
    slow_timeout_ns: int = 500_000_000
    """... but not before what the way takes by itself on that link, up to this: a slow link is not
    one miss after the other, and past this it is of no use."""


class _Worker:
    """What is out to one worker."""

    __slots__ = (
        "clock",
        "missed",
        "next_ns",
        "remembered",
        "rtt_spread_ns",
        "srtt_ns",
        "unanswered",
    )

    def __init__(self, next_ns: int) -> None:
        self.next_ns = next_ns
        self.clock = ClockOffset()
        self.remembered: dict[int, int | None] = {}
        """t1 of each probe by sequence, oldest first; None: its echo is here."""
        self.unanswered: deque[tuple[int, int]] = deque(maxlen=MAX_REMEMBERED)
        """Sequence and t1 of what is neither answered nor missed yet."""
        self.missed = 0
        self.srtt_ns: int | None = None
        self.rtt_spread_ns = 0
        """Smoothed deviation of the round trips."""

    def smooth(self, rtt_ns: int) -> None:
        # V. Jacobson, "Congestion avoidance and control", 1988; the gains of RFC 6298
        if self.srtt_ns is None:
            self.srtt_ns, self.rtt_spread_ns = rtt_ns, rtt_ns // 2
            return
        self.rtt_spread_ns += (abs(rtt_ns - self.srtt_ns) - self.rtt_spread_ns) // 4
        self.srtt_ns += (rtt_ns - self.srtt_ns) // 8


class Prober:
    """Bookkeeping of the probes of one start of the client."""

    def __init__(self, boot_id: int, settings: ProberSettings | None = None) -> None:
        self.echoes = 0
        """Taken."""
        self.timed_out = 0
        """Probes that neither their own echo nor a later one answered in time."""
        self.duplicates = 0
        self.unknown = 0
        """Never asked for, too long ago, of a worker that is gone, or with another t1."""
        self.foreign = 0
        """Of another start of this client."""
        self._boot_id = boot_id
        self._settings = settings or ProberSettings()
        self._workers: dict[str, _Worker] = {}
        self._worker_of: dict[int, str] = {}
        """Worker by sequence, over all that is remembered."""
        self._next_sequence = 0
        self._joined = 0
        self._now_ns = 0

    def due(self, now_ns: int, workers: Collection[str]) -> list[tuple[str, Probe]]:
        """The probes to send now.

        A new worker's phase is such that it is not probed along with the others; what was due
        while nobody asked is left out and not made up for. A worker that is not in ``workers`` any
        more is forgotten.
        """
        self._see(now_ns, workers)
        probes = []
        for name, worker in self._workers.items():
            if now_ns < worker.next_ns:
                continue
            period_ns = self._settings.period_ns
            worker.next_ns += ((now_ns - worker.next_ns) // period_ns + 1) * period_ns
            probes.append((name, self._probe(name, worker, now_ns)))
        return probes

    def echo(self, probe: Probe, t4_ns: int) -> str | None:
        """Take an echo; the worker it came from, or None if it is not one of ours.

        Args:
            probe: as it came back, with the worker's stamps.
            t4_ns: when it was here, drone's clock.
        """
        if probe.boot_id != self._boot_id:
            self.foreign += 1
            return None
        name = self._worker_of.get(probe.sequence)
        if name is None:
            self.unknown += 1
            return None
        worker = self._workers[name]
        t1_ns = worker.remembered[probe.sequence]
        if t1_ns is None:
            self.duplicates += 1
            return None
        if t1_ns != probe.t1_ns:
            self.unknown += 1
            return None
        self.echoes += 1
        self._now_ns = max(self._now_ns, t4_ns)
        worker.remembered[probe.sequence] = None
        # What was sent before it and is still out was overtaken: that is loss, but no silence
        while worker.unanswered and worker.unanswered[0][0] <= probe.sequence:
            worker.unanswered.popleft()
        worker.missed = 0
        echo = Echo(t1_ns, probe.t2_ns, probe.t3_ns, t4_ns, probe.worker_boot_id)
        worker.clock.add(echo)
        worker.smooth(max(0, t4_ns - t1_ns))
        return name

    def missed(self, worker: str, now_ns: int) -> int:
        """Echoes missed since the last one that came: the silence, in probes."""
        w = self._workers.get(worker)
        if w is None:
            return 0
        self._now_ns = max(self._now_ns, now_ns)
        timeout_ns = self._timeout_ns(w)
        while w.unanswered and w.unanswered[0][1] + timeout_ns <= now_ns:
            w.unanswered.popleft()
            w.missed += 1
            self.timed_out += 1
        return w.missed

    def timeout_ns(self, worker: str) -> int:
        """How long an echo of this worker is waited for."""
        w = self._workers.get(worker)
        return self._settings.max_timeout_ns if w is None else self._timeout_ns(w)

    def srtt_ns(self, worker: str) -> int | None:
        """Smoothed round trip, the worker's own share included; None: no echo yet."""
        w = self._workers.get(worker)
        return None if w is None else w.srtt_ns

    def estimate(self, worker: str) -> OffsetEstimate | None:
        """Clock offset and round trips of a worker at the newest time told; None: no echo yet."""
        w = self._workers.get(worker)
        return None if w is None else w.clock.estimate(self._now_ns)

    def clock_events(self, worker: str) -> tuple[int, int, int]:
        """Restarts and clock steps that the echoes of a worker showed, and echoes of no use."""
        w = self._workers.get(worker)
        return (0, 0, 0) if w is None else (w.clock.restarts, w.clock.steps, w.clock.unused)

    def _see(self, now_ns: int, workers: Collection[str]) -> None:
        self._now_ns = max(self._now_ns, now_ns)
        for name in [n for n in self._workers if n not in workers]:
            for sequence in self._workers.pop(name).remembered:
                del self._worker_of[sequence]
        for name in sorted(workers):
            if name not in self._workers:
                phase = self._joined * GOLDEN_SHARE % 1.0
                self._workers[name] = _Worker(now_ns + round(phase * self._settings.period_ns))
                self._joined += 1

    def _probe(self, name: str, worker: _Worker, now_ns: int) -> Probe:
        sequence = self._next_sequence
        self._next_sequence += 1
        if len(worker.remembered) >= MAX_REMEMBERED:
            oldest = next(iter(worker.remembered))
            del worker.remembered[oldest], self._worker_of[oldest]
        worker.remembered[sequence] = now_ns
        worker.unanswered.append((sequence, now_ns))
        self._worker_of[sequence] = name
        return Probe(self._boot_id, sequence, now_ns)

    def _timeout_ns(self, worker: _Worker) -> int:
        s = self._settings
        if worker.srtt_ns is None:
            return s.max_timeout_ns
        wished_ns = min(max(s.round_trips * worker.srtt_ns, s.min_timeout_ns), s.max_timeout_ns)
        slow_ns = min(worker.srtt_ns + 4 * worker.rtt_spread_ns, s.slow_timeout_ns)
        return max(wished_ns, slow_ns)
