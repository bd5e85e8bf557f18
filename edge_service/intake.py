"""The receiving end: what every message from the network passes before it waits for the worker.

All of this runs on the network's own threads, so it is short: one look at the envelope, one CRC,
one header.
"""

from __future__ import annotations

import logging

from edge_service.mailbox import Arrival, Mailbox, Verdict
from edge_service.metrics import Metrics
from edge_service.pipeline import Output
from edge_service.replies import Replies
from rgbd_wire.clock import Clock
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.errors import DecodeError
from rgbd_wire.frame_codec import unpack
from rgbd_wire.messages import Outcome
from rgbd_wire.probe import decode_probe

log = logging.getLogger(__name__)

REPEATED = "repeated"
WRONG_DRONE = "wrong_drone"
"""Reasons under which messages are refused here, beside those of ``Reject``."""

ANSWERS = {
    Verdict.OUTDATED: Output(Outcome.SUPERSEDED, "a newer frame of this drone has come in"),
    Verdict.NO_ROOM: Output(Outcome.OVERLOADED, "this worker has as many drones as it may"),
    Verdict.CLOSED: Output(Outcome.DRAINING, "this worker is about to stop"),
}
"""What a frame without a place is told."""

_KIND_OFFSET = 5


class Intake:
    """Checks a message; echoes a probe, acknowledges a frame and puts it into the mailbox."""

    def __init__(self, mailbox: Mailbox, replies: Replies, metrics: Metrics, clock: Clock) -> None:
        self._mailbox = mailbox
        self._replies = replies
        self._metrics = metrics
        self._clock = clock
        self._seen_rejects: set[str] = set()

    def on_message(self, drone: str, data: bytes | memoryview, t2_ns: int) -> None:
        """Take one message that was complete at ``t2_ns``; a bad one is counted and dropped.

        Args:
            drone: who sent it, as the network knows it.
            data: the message, FRAME or PROBE.
            t2_ns: its last byte at the socket, worker's clock.
        """
        try:
            if len(data) > _KIND_OFFSET and data[_KIND_OFFSET] == Kind.PROBE:
                self._on_probe(drone, data, t2_ns)
            else:
                self._on_frame(drone, data, t2_ns)
        except DecodeError as error:
            self._reject(error.reason.value, str(error))

    def _on_probe(self, drone: str, data: bytes | memoryview, t2_ns: int) -> None:
        _, body = unseal(data, Kind.PROBE)
        self._replies.echo(drone, decode_probe(body), t2_ns)
        self._metrics.probes.inc()

    def _on_frame(self, drone: str, data: bytes | memoryview, t2_ns: int) -> None:
        packed = unpack(data)
        header = packed.header
        if header.drone != drone:
            # Not answered: neither of the two has sent it for certain
            self._reject(WRONG_DRONE, f"a frame of {header.drone} came from {drone}")
            return
        verdict = self._mailbox.admit(header, self._clock.now_ns())
        if verdict is Verdict.REPEATED:
            self._reject(REPEATED, f"sequence {header.sequence} of {header.drone} came before")
            return
        # Before the frame can be taken, so that its result never overtakes its ack
        self._replies.ack(header)
        arrival = Arrival(packed, t2_ns)
        left = self._mailbox.put(arrival) if verdict is Verdict.ADMITTED else (arrival, verdict)
        if left is not None:
            loser, why = left
            self._replies.answer(loser, ANSWERS[why])

    def _reject(self, reason: str, detail: str) -> None:
        self._metrics.rejected.labels(reason).inc()
        if reason not in self._seen_rejects:  # the counter tells how often; the log, that it is so
            self._seen_rejects.add(reason)
            log.warning("message refused", extra={"reason": reason, "detail": detail})
