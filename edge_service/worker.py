"""The loop that serves frames, one after the other, in a thread of its own."""

from __future__ import annotations

import dataclasses
import logging
import threading

from edge_service.mailbox import Arrival, Mailbox
from edge_service.pipeline import Output, Pipeline, bounded
from edge_service.replies import Replies
from rgbd_wire.clock import Clock
from rgbd_wire.messages import Outcome

log = logging.getLogger(__name__)

IDLE_BEAT_S = 0.5
"""How often a worker that has nothing to do shows that it is alive."""


class Worker:
    """Takes frames until the mailbox is closed and empty."""

    def __init__(
        self, mailbox: Mailbox, pipeline: Pipeline, replies: Replies, clock: Clock
    ) -> None:
        self._mailbox = mailbox
        self._pipeline = pipeline
        self._replies = replies
        self._clock = clock
        self._beat_ns = clock.now_ns()
        # A daemon: an inference that hangs must not keep the process from ending
        self._thread = threading.Thread(target=self.run, name="worker", daemon=True)

    @property
    def silent_ns(self) -> int:
        """How long ago the loop last came round."""
        return self._clock.now_ns() - self._beat_ns

    def start(self) -> None:
        """Run the loop in its thread."""
        self._thread.start()

    def join(self, timeout_s: float) -> bool:
        """Wait for the loop to end; whether it has."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def run(self) -> None:
        """Serve until the mailbox is closed and empty."""
        while not self._mailbox.finished:
            self._beat_ns = self._clock.now_ns()
            arrival = self._mailbox.take(IDLE_BEAT_S)
            if arrival is not None:
                self._serve(arrival)

    def _serve(self, arrival: Arrival) -> None:
        """Work on one frame and answer it; whatever goes wrong is an outcome."""
        waited_ns = self._clock.now_ns() - arrival.t2_ns
        stages_ns = {"queue": waited_ns}
        budget_ns = arrival.packed.header.budget_ns
        # It left the drone before it came in here, so no two clocks need comparing to know that
        # nobody waits for it any more
        if waited_ns > budget_ns:
            reason = f"waited {waited_ns / 1e6:.0f} ms of a budget of {budget_ns / 1e6:.0f} ms"
            late = Output(Outcome.OVERLOADED, bounded(reason), stages_ns=stages_ns)
            self._replies.answer(arrival, late)
            return
        try:
            output = self._pipeline.process(arrival.packed)
            output = dataclasses.replace(output, stages_ns=stages_ns | output.stages_ns)
            self._replies.answer(arrival, output)
        except Exception as error:  # the process boundary: one frame must not end the service
            log.exception("frame failed", extra={"drone": arrival.packed.header.drone})
            failed = Output(Outcome.FAILED, bounded(type(error).__name__), stages_ns=stages_ns)
            self._replies.answer(arrival, failed)
