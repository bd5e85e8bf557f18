"""The way up: newest frame -> room in the window -> encode -> stamp t1 -> link.

The frame is taken from its slot only when the window has room, so what is sent is never older
than one encoding.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Protocol

from drone_client.ack_clock import AckClock
from drone_client.gate import SentFrame
from drone_client.ledger import Fate, FrameEntry, Ledger
from drone_client.link import Link
from drone_client.newest import Newest
from drone_client.worker_choice import choose_worker
from rgbd_wire.clock import Clock
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import FrameStamp, compress, pack

logger = logging.getLogger(__name__)


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
    budget_ns: int
    """What a frame says of how long its result is of use."""
    jpeg_quality: int


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
    """Owns the sending thread, the one-slot mailbox and the ack clock."""

    def __init__(
        self, settings: UplinkSettings, link: Link, clock: Clock, log: SendLog, ledger: Ledger
    ) -> None:
        self.send_failures = 0
        self._settings = settings
        self._link = link
        self._clock = clock
        self._log = log
        self._ledger = ledger
        self._slot: Newest[_Captured] = Newest()
        self._acks = AckClock(settings.window, settings.ack_timeout_ns)
        self._room = threading.Condition()
        self._asked: dict[int, str] = {}
        """Worker of each frame that holds a slot."""
        self._silent: set[str] = set()
        """Workers that left a frame unacknowledged and were not heard of since."""
        self._worker: str | None = None
        self._sequence = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="uplink", daemon=True)

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
        return sequence

    def heard(self, sequence: int, worker: str) -> None:
        """An ack or a result of a frame arrived: free its slot."""
        with self._room:
            self._silent.discard(worker)
            if self._acks.release(sequence):
                del self._asked[sequence]
                self._room.notify()

    def stop(self) -> None:
        """Stop sending; a frame that waits is left to the ledger."""
        self._stopping.set()
        self._slot.close()
        with self._room:
            self._room.notify()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while not self._stopping.is_set():
            if self._wait_for_room(timeout_s=0.05):
                captured = self._slot.take(timeout_s=0.05)
                if captured is not None:
                    self._try_to_send(captured)

    def _try_to_send(self, captured: _Captured) -> None:
        try:
            self._send(captured)
        except Exception:
            # A frame that cannot be sent is no reason to send no more: a thread that ended here
            # would leave the drone blind, and the run waiting for this frame's fate for ever.
            if not self.send_failures:
                logger.exception("frame %d could not be sent", captured.sequence)
            self.send_failures += 1
            self._ledger.close_frame(captured.sequence, Fate.SEND_FAILED, {})

    def _wait_for_room(self, timeout_s: float) -> bool:
        with self._room:
            self._expire()
            if not self._acks.has_room():
                self._room.wait(timeout_s)
                self._expire()
            return self._acks.has_room()

    def _expire(self) -> None:
        now_ns = self._clock.now_ns()
        for sequence in self._acks.expire(now_ns):
            # A worker that leaves frames unacknowledged is asked again only if there is no other.
            worker = self._asked.pop(sequence)
            self._silent.add(worker)
            self._ledger.event(now_ns, "ack_timeout", sequence=sequence, worker=worker)

    def _send(self, captured: _Captured) -> None:
        worker = self._choose_worker()
        if worker is None:
            self._ledger.close_frame(captured.sequence, Fate.NO_WORKER, {})
            return
        s, frame = self._settings, captured.frame
        compressed = compress(frame, s.jpeg_quality)
        t1_ns = self._clock.now_ns()
        stamp = FrameStamp(s.drone, s.boot_id, captured.sequence, t1_ns, s.budget_ns)
        message = pack(compressed, stamp)
        self._log.sending(SentFrame(captured.sequence, frame.t_capture_ns, t1_ns, worker))
        self._ledger.sent(captured.sequence, t1_ns, worker, len(message))
        with self._room:
            self._acks.send(captured.sequence, t1_ns)
            self._asked[captured.sequence] = worker
        self._link.send(worker, message)

    def _choose_worker(self) -> str | None:
        live = self._link.workers()
        with self._room:
            self._expire()  # the frame may have come long after there was room
            self._silent.intersection_update(live)  # one that went and came back starts afresh
            silent = frozenset(self._silent)
        worker = choose_worker(self._settings.drone, live, self._worker, silent)
        if worker != self._worker:
            self._ledger.event(
                self._clock.now_ns(), "worker", before=self._worker, now=worker, live=live
            )
            self._worker = worker
        return worker
