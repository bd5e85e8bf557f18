"""The receiving end: what every message from the network passes before it waits for the worker.

All of this runs on the network's own threads, so it is short: one look at the envelope, one CRC,
one header.
"""

from __future__ import annotations

import logging

from edge_service.deadline import Deadline, Ruling
from edge_service.first_look import look
from edge_service.mailbox import Arrival, Mailbox, Verdict
from edge_service.metrics import Metrics
from edge_service.pipeline import Output
from edge_service.quota import Pace, Quotas
from edge_service.replies import Replies
from rgbd_wire.clock import Clock
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.errors import DecodeError
from rgbd_wire.frame_codec import unpack
from rgbd_wire.messages import Outcome
from rgbd_wire.probe import decode_probe
from rgbd_wire.streams import PROBE

log = logging.getLogger(__name__)

PROBES_HZ = 4 * PROBE.rate_hz
TOO_FAST = Output(Outcome.OVERLOADED, "this drone sends more often than it may")

ANSWERS = {
    Verdict.OUTDATED: Output(Outcome.SUPERSEDED, "a newer frame of this drone has come in"),
    Verdict.NO_ROOM: Output(Outcome.OVERLOADED, "this worker has as many drones as it may"),
    Verdict.CLOSED: Output(Outcome.DRAINING, "this worker is about to stop"),
}
"""What a frame without a place is told."""

_KIND_OFFSET = 5


class Intake:
    """Checks a message; echoes a probe, acknowledges a frame and puts it into the mailbox."""

    def __init__(
        self,
        mailbox: Mailbox,
        replies: Replies,
        deadline: Deadline,
        metrics: Metrics,
        clock: Clock,
        max_rate_hz: float,
        max_drones: int,
    ) -> None:
        self._mailbox = mailbox
        self._replies = replies
        self._deadline = deadline
        self._metrics = metrics
        self._clock = clock
        remembered = 4 * max_drones  # those that have no slot are turned away in bounds, too
        self._frame_quotas = Quotas(max_rate_hz, remembered)
        self._probe_quotas = Quotas(PROBES_HZ, remembered)
        self._seen_rejects: set[str] = set()

    def on_message(self, drone: str | None, data: bytes | memoryview, t2_ns: int) -> None:
        """Take one message that was complete at ``t2_ns``; a bad one is counted and dropped.

        Args:
            drone: who sent it, as the network knows it; None: it names nobody.
            data: the message, FRAME or PROBE.
            t2_ns: its last byte at the socket, worker's clock.
        """
        if drone is None:
            self._reject("no_drone", "a key that names no drone")
            return
        try:
            if len(data) > _KIND_OFFSET and data[_KIND_OFFSET] == Kind.PROBE:
                self._on_probe(drone, data, t2_ns)
                return
            pace = self._frame_quotas.pace(drone, self._clock.now_ns())
            if pace is Pace.FINE:
                self._on_frame(drone, data, t2_ns)
            else:
                self._turn_away(drone, data, t2_ns, pace)
        except DecodeError as error:
            self._reject(error.reason.value, str(error))
        except Exception as error:  # the network thread's boundary: it serves other drones, too
            self._reject("fault", repr(error), error)

    def _on_probe(self, drone: str, data: bytes | memoryview, t2_ns: int) -> None:
        if self._probe_quotas.pace(drone, self._clock.now_ns()) is not Pace.FINE:
            self._reject("too_fast", f"probes of {drone}")
            return
        _, body = unseal(data, Kind.PROBE)
        self._replies.echo(drone, decode_probe(body), t2_ns)
        self._metrics.probes.inc()

    def _turn_away(self, drone: str, data: bytes | memoryview, t2_ns: int, pace: Pace) -> None:
        """Count a frame that is too much, and answer it as long as that is cheap."""
        self._reject("too_fast", f"frames of {drone}")
        if pace is Pace.TOO_FAST:
            header = look(data)
            if header.drone == drone:
                self._replies.answer(header, t2_ns, TOO_FAST)

    def _on_frame(self, drone: str, data: bytes | memoryview, t2_ns: int) -> None:
        packed = unpack(data)
        header = packed.header
        if header.drone != drone:
            # Not answered: neither of the two has sent it for certain
            self._reject("wrong_drone", f"a frame of {header.drone} came from {drone}")
            return
        now_ns = self._clock.now_ns()
        verdict = self._mailbox.admit(header, now_ns)
        if verdict is Verdict.REPEATED:
            self._reject("repeated", f"sequence {header.sequence} of {header.drone} came before")
            return
        # Before the frame can be taken, so that its result never overtakes its ack
        self._replies.ack(header)
        if verdict is not Verdict.ADMITTED:
            self._replies.answer(header, t2_ns, ANSWERS[verdict])
            return
        # What it may have to wait is left out: it will be the newest of its drone when its turn
        # comes, or make way for one that is
        ruling, prospect = self._deadline.rule(now_ns - t2_ns, header.budget_ns, now_ns)
        if ruling is Ruling.DROP:
            self._metrics.dropped.labels("intake").inc()
            self._replies.answer(header, t2_ns, prospect.dropped())
            return
        left = self._mailbox.put(Arrival(packed, t2_ns, is_try=ruling is Ruling.TRY))
        if left is not None:
            loser, why = left
            self._replies.answer(loser.packed.header, loser.t2_ns, ANSWERS[why])

    def _reject(self, reason: str, detail: str, fault: Exception | None = None) -> None:
        self._metrics.rejected.labels(reason).inc()
        if reason not in self._seen_rejects:  # the counter tells how often; the log, that it is so
            self._seen_rejects.add(reason)
            extra = {"reason": reason, "detail": detail}
            log.warning("message refused", extra=extra, exc_info=fault)
