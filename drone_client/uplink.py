"""The way up: newest frame -> departure -> encode -> stamp t1 -> link; and the watch beside it.

The frame is taken from its slot only when it may leave, so what is sent is never older than one
encoding. The same thread sends probes and second copies: one thread alone writes to the link.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Protocol

from drone_client.clock_offset import OffsetEstimate
from drone_client.departures import Departures
from drone_client.encoding_choice import EncodingChoice
from drone_client.gate import SentFrame
from drone_client.goodput import Goodput
from drone_client.ledger import Fate, FrameEntry, Ledger
from drone_client.link import Link
from drone_client.newest import Newest
from drone_client.reception import Reception
from drone_client.under_way import UnderWay
from drone_client.watch import MIN_ACK_WAIT_NS, Copy, WorkerWatch
from rgbd_wire.clock import Clock
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import CompressedFrame, FrameStamp, compress, pack
from rgbd_wire.messages import Status
from rgbd_wire.probe import Probe, seal_probe

logger = logging.getLogger(__name__)

REMEMBERED_FRAMES = 32
"""Whose ack still tells something when it comes late."""
TICK_S = 0.005
"""How often the watch looks, with nothing else to do: a fraction of what it has to notice."""


@dataclass(frozen=True, slots=True)
class UplinkSettings:
    """How frames leave the drone."""

    drone: str
    boot_id: int
    """Random per start of the client."""
    window: int
    """Frames in the network at most."""
    ack_timeout_ns: int
    """A slot is freed by force after this long without an ack."""
    age_max_ns: int
    """A result is of no use past this age."""
    hedge: bool = False
    """Send a second copy of a frame whose answer is late."""


class SendLog(Protocol):
    """Is told of a frame before it leaves, so that no answer can come too early."""

    def sending(self, frame: SentFrame) -> None:
        """The frame is about to be sent."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Captured:
    sequence: int
    frame: RgbdFrame


class Uplink:
    """Owns the sending thread, the one-slot mailbox, the ack clock and the watch."""

    def __init__(
        self,
        settings: UplinkSettings,
        link: Link,
        clock: Clock,
        log: SendLog,
        ledger: Ledger,
        choice: EncodingChoice,
    ) -> None:
        self.send_failures = 0
        self._settings = settings
        self._link = link
        self._clock = clock
        self._log = log
        self._ledger = ledger
        self._choice = choice
        self._slot: Newest[_Captured] = Newest()
        self._sequence = 0
        self._changed = threading.Condition()
        """Guards all of the following; notified when the thread has reason to look."""
        self._departures = Departures(settings.window, settings.ack_timeout_ns)
        self._goodput = Goodput()
        self._sent: dict[int, tuple[int, int]] = {}
        """Bytes and t1 of the frames that were not acknowledged, the oldest first."""
        self._watch = WorkerWatch(
            settings.drone, settings.boot_id, settings.age_max_ns, hedge=settings.hedge
        )
        self._encoding_ns = 0
        """What encoding takes, lately."""
        self._due = False
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="uplink", daemon=True)

    def estimate(self, worker: str) -> OffsetEstimate | None:
        """Clock offset and round trips of a worker, by its probes."""
        with self._changed:
            return self._watch.estimate(worker)

    def standings(self) -> dict[str, str]:
        """What this drone thinks of its workers."""
        with self._changed:
            return self._watch.standings()

    @property
    def same_name_workers(self) -> list[str]:
        """Names under which two workers are there at once."""
        with self._changed:
            return self._watch.same_name

    @property
    def goodput_bytes_per_s(self) -> float | None:
        """What the link carries, as far as it is known."""
        with self._changed:
            return self._goodput.bytes_per_s

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def submit(self, frame: RgbdFrame, name: str) -> int:
        """Offer a frame; returns its sequence. A frame still waiting is displaced and told so."""
        sequence, self._sequence = self._sequence, self._sequence + 1
        self._ledger.captured(FrameEntry(sequence, name, frame.t_capture_ns))
        displaced = self._slot.put(_Captured(sequence, frame))
        if displaced is not None:
            self._ledger.close_frame(displaced.sequence, Fate.SUPERSEDED_ON_BOARD, {})
        self.wake()
        return sequence

    def wake(self) -> None:
        """There is something new to look at: a frame, an answer, a worker that came or went."""
        with self._changed:
            self._due = True
            self._changed.notify()

    def heard(self, sequence: int, worker: str, t_ns: int) -> None:
        """An ack or a result of a frame arrived: free its slot, learn from it."""
        with self._changed:
            self._watch.heard(sequence, worker, t_ns)
            round_trip_ns = self._watch.round_trip_ns(worker)
            self._departures.release(sequence, t_ns, round_trip_ns)
            # Also when its slot was freed by force: that ack tells best how slow the link is
            sent = self._sent.pop(sequence, None)
            if sent is not None:
                self._goodput.acked(*sent, t_ns, round_trip_ns)
        self.wake()

    def answered(self, reception: Reception) -> None:
        """A result arrived and was judged."""
        result = reception.result
        with self._changed:
            self._watch.answered(
                result.sequence,
                result.worker,
                reception.t4_ns,
                result.outcome,
                settled=reception.settles,
            )
            if result.draining:
                self._watch.drains(result.worker)
        self.wake()

    def echo(self, probe: Probe, t4_ns: int) -> None:
        """A probe came back."""
        with self._changed:
            self._watch.echo(probe, t4_ns)

    def take_status(self, status: Status) -> None:
        """A worker says how it is."""
        with self._changed:
            self._watch.take_status(status)
        if status.draining:
            self.wake()

    def will_answer(self, workers: frozenset[str]) -> bool:
        """Whether one of these workers may still answer a frame that it has."""
        with self._changed:
            return not self._watch.hopeless(workers)

    def stop(self) -> None:
        """Stop sending; a frame that waits is left to the ledger."""
        self._stopping.set()
        self._slot.close()
        self.wake()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._tick()
            except Exception:
                # A watch that ended here would leave the drone with a dead worker for ever.
                self._count_failure("the watch over the workers failed")
            wait_s = self._until_departure_s()
            captured = self._slot.take(0) if wait_s == 0 else None
            if captured is not None:
                self._try_to_send(captured)
                continue
            with self._changed:
                if not self._due:
                    self._changed.wait(min(wait_s or TICK_S, TICK_S))
                self._due = False

    def _count_failure(self, what: str) -> None:
        if not self.send_failures:
            logger.exception(what)
        self.send_failures += 1

    def _until_departure_s(self) -> float:
        with self._changed:
            wait_ns = self._departures.wait_ns(self._clock.now_ns(), self._encoding_ns)
        return TICK_S if wait_ns is None else wait_ns / 1e9

    def _tick(self) -> None:
        """Free what will not be acknowledged, probe, hand over."""
        live = self._link.workers()
        now_ns = self._clock.now_ns()
        with self._changed:
            expired = self._departures.expire(now_ns)
            actions = self._watch.tick(now_ns, live)
            for sequence in expired:
                if (sent := self._sent.get(sequence)) is not None:
                    self._goodput.timed_out(*sent, now_ns)
            for sequence in actions.lost:
                self._departures.forget(sequence)
                self._sent.pop(sequence, None)  # the worker is at fault, not the link
        for sequence in expired:
            self._ledger.event(now_ns, "ack_timeout", sequence=sequence)
        for name, details in actions.events:
            self._ledger.event(now_ns, name, **details)
        for worker in actions.unheard:
            self._link.unheard(worker)
        for copy in actions.copies:
            self._send_copy(copy)
        for worker, probe in actions.probes:
            self._link.send_urgent(worker, seal_probe(probe))

    def _try_to_send(self, captured: _Captured) -> None:
        try:
            self._send(captured)
        except Exception:
            # A frame that cannot be sent is no reason to send no more: a thread that ended here
            # would leave the drone blind, and the run waiting for this frame's fate for ever.
            self._count_failure(f"frame {captured.sequence} could not be sent")
            self._ledger.close_frame(captured.sequence, Fate.SEND_FAILED, {})

    def _send(self, captured: _Captured) -> None:
        s, frame = self._settings, captured.frame
        started_ns = self._clock.now_ns()
        with self._changed:
            worker = self._watch.choose(started_ns, self._link.workers())
            round_trip_ns = 0 if worker is None else self._watch.round_trip_ns(worker)
            goodput = self._goodput.bytes_per_s
        if worker is None:
            self._ledger.close_frame(captured.sequence, Fate.NO_WORKER, {})
            return
        choice = self._choice.choose(frame, started_ns, goodput)
        compressed = compress(frame, choice.encoding)
        self._choice.weighed(choice, len(compressed.color), compressed.depth.size_bytes)
        t1_ns = self._clock.now_ns()
        self._encoding_ns += (t1_ns - started_ns - self._encoding_ns) // 4
        budget_ns = s.age_max_ns - (t1_ns - frame.t_capture_ns) - round_trip_ns
        if budget_ns <= 0:
            self._ledger.close_frame(captured.sequence, Fate.TOO_OLD_ON_BOARD, {})
            return
        message = self._pack(captured.sequence, compressed, t1_ns, budget_ns)
        serialisation_ns = 0 if goodput is None else round(1e9 * len(message) / goodput)
        ack_wait_ns = MIN_ACK_WAIT_NS + 2 * serialisation_ns + 4 * round_trip_ns
        sent = UnderWay(
            captured.sequence,
            compressed,
            [worker],
            t1_ns,
            t1_ns + min(ack_wait_ns, s.ack_timeout_ns),
        )
        self._ledger.sent(captured.sequence, t1_ns, worker, len(message), choice.record())
        with self._changed:
            self._departures.send(captured.sequence, worker, t1_ns, serialisation_ns)
            self._sent[captured.sequence] = len(message), t1_ns
            while len(self._sent) > REMEMBERED_FRAMES:
                del self._sent[next(iter(self._sent))]
            self._watch.sent(sent)
        self._log.sending(SentFrame(captured.sequence, frame.t_capture_ns, t1_ns, worker))
        self._link.send(worker, message, budget_ns)

    def _send_copy(self, copy: Copy) -> None:
        """Send a frame that left already to another worker, stamped anew."""
        frame, t1_ns = copy.frame, self._clock.now_ns()
        with self._changed:
            round_trip_ns = self._watch.round_trip_ns(copy.worker)
        age_ns = t1_ns - frame.t_capture_ns
        budget_ns = self._settings.age_max_ns - age_ns - round_trip_ns
        if budget_ns <= 0:
            return
        message = self._pack(frame.sequence, frame.compressed, t1_ns, budget_ns)
        self._log.sending(SentFrame(frame.sequence, frame.t_capture_ns, t1_ns, copy.worker))
        self._link.send(copy.worker, message, budget_ns)

    def _pack(
        self, sequence: int, compressed: CompressedFrame, t1_ns: int, budget_ns: int
    ) -> bytes:
        s = self._settings
        return pack(compressed, FrameStamp(s.drone, s.boot_id, sequence, t1_ns, budget_ns))
