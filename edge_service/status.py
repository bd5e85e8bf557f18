"""What a worker says of itself to drones that choose: a few times a second, and when it drains."""

from __future__ import annotations

import logging
import threading

from edge_service.mailbox import Mailbox
from edge_service.replies import Replies
from edge_service.transport import Transport
from rgbd_wire.messages import Status, seal_status
from rgbd_wire.streams import STATUS_RATE_HZ

JOIN_S = 1.0
"""For a status that is just being sent; no transport takes that long."""

log = logging.getLogger(__name__)


class StatusPublisher:
    """Publishes the status in a thread of its own.

    Args:
        replies: who the worker is, and how long its answers took of late.
        mailbox: what waits.
        max_drones: how many drones have room in it.
        transport: drops a status rather than waiting for the link.
    """

    def __init__(
        self, replies: Replies, mailbox: Mailbox, max_drones: int, transport: Transport
    ) -> None:
        self._replies = replies
        self._mailbox = mailbox
        self._max_drones = max_drones
        self._transport = transport
        self._sequence = 0
        self._one_at_a_time = threading.Lock()
        self._stop = threading.Event()
        self._failed = False
        self._thread = threading.Thread(target=self._run, name="status", daemon=True)

    def start(self) -> None:
        """Begin to publish."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread, at once."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)

    def publish(self) -> None:
        """Publish how it is now, out of turn; whatever goes wrong is logged."""
        try:
            with self._one_at_a_time:  # so that they leave in the order of their sequences
                self._transport.publish(seal_status(self._status()))
        except Exception:  # the thread's boundary: a worker without status still serves
            if not self._failed:
                log.exception("status not published")
            self._failed = True

    def _run(self) -> None:
        while not self._stop.is_set():
            self.publish()
            self._stop.wait(1 / STATUS_RATE_HZ)

    def _status(self) -> Status:
        replies = self._replies
        p50_ns, p95_ns = replies.recent.quantile_ns(0.5, 0.95)
        self._sequence += 1
        return Status(
            worker=replies.worker,
            worker_boot_id=replies.boot_id,
            sequence=self._sequence,
            waiting=self._mailbox.waiting,
            drones=self._mailbox.drones,
            max_drones=self._max_drones,
            service_p50_ns=p50_ns,
            service_p95_ns=p95_ns,
            model=replies.model_hash,
            draining=replies.draining,
        )
