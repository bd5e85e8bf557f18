"""The frame path as a whole: brings its parts up in order, and down again without losing a frame.

Up: frames taken -> worker -> token announced -> status. Down: status says draining -> token
withdrawn -> new frames are told DRAINING, those that wait are answered -> link closed.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable

from edge_service.deadline import Deadline
from edge_service.intake import ANSWERS, Intake
from edge_service.mailbox import Verdict
from edge_service.pipeline import Pipeline
from edge_service.replies import Replies
from edge_service.service_time import ServiceTime
from edge_service.settings import EdgeSettings
from edge_service.state import ServiceState
from edge_service.status import StatusPublisher
from edge_service.transport import Transport
from edge_service.worker import Worker
from rgbd_wire.clock import Clock

LAST_FRAME_S = 1.0
"""For the frame that is in work when the time is up; longer than any takes."""
LINGER_S = 0.25
"""After the token is down: what is on its way by then is still told to go elsewhere."""


class EdgeService:
    """From the link to the answer, without the HTTP side and the process around it."""

    def __init__(
        self,
        settings: EdgeSettings,
        pipeline: Pipeline,
        transport: Transport,
        state: ServiceState,
        clock: Clock,
    ) -> None:
        self._settings = settings
        self._transport = transport
        self._state = state
        model_hash = pipeline.detector.model_hash
        metrics, mailbox = state.metrics, state.mailbox
        boot_id = secrets.randbits(63)
        self._replies = Replies(settings.name, boot_id, model_hash, transport, metrics, clock)
        times = ServiceTime()
        deadline = Deadline(times)
        self._intake = Intake(
            mailbox,
            self._replies,
            deadline,
            metrics,
            clock,
            max_rate_hz=settings.max_rate_hz,
            max_drones=settings.max_drones,
        )
        limits = settings.batch_limits
        self._worker = Worker(
            mailbox, pipeline, self._replies, times, deadline, limits, metrics, clock
        )
        self._status = StatusPublisher(self._replies, mailbox, settings.max_drones, transport)
        metrics.describe(settings.name, model_hash, pipeline.detector.describe())
        state.pipeline = pipeline

    def start(self) -> None:
        """Serve on the open link, and say so."""
        self._transport.start(self._intake.on_message)
        self._worker.start()
        self._state.worker = self._worker
        self._transport.announce()
        self._status.start()

    def drain(self, wait: Callable[[float], None]) -> bool:
        """Answer what is there, turn away what comes, and close the link.

        It takes at most ``drain_s`` for the frames that wait, and ``LINGER_S + LAST_FRAME_S``.

        Args:
            wait: sleeps for so long [s].

        Returns:
            Whether every frame has been answered; False: the worker is stuck with one.
        """
        self._state.draining = True
        self._replies.draining = True
        self._status.publish()
        self._transport.withdraw()
        self._state.mailbox.close()
        self._worker.join(self._settings.drain_s)
        for arrival in self._state.mailbox.empty():
            self._replies.answer(arrival.packed.header, arrival.t2_ns, ANSWERS[Verdict.CLOSED])
        wait(LINGER_S)
        finished = self._worker.join(LAST_FRAME_S)
        self._status.stop()
        self._transport.close()
        return finished
