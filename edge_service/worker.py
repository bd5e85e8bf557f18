"""The loop that serves frames, batch after batch, in a thread of its own."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from edge_service.batching import BatchLimits, gather
from edge_service.deadline import Deadline, Ruling
from edge_service.errors import ImageError
from edge_service.mailbox import Arrival, Mailbox
from edge_service.metrics import Metrics
from edge_service.pipeline import Output, Pipeline, bounded
from edge_service.replies import Replies
from edge_service.service_time import ServiceTime
from rgbd_wire.clock import Clock
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.messages import Outcome

log = logging.getLogger(__name__)

IDLE_BEAT_S = 0.5
"""How often a worker that has nothing to do shows that it is alive."""


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """A frame in work."""

    arrival: Arrival
    stages_ns: dict[str, int]


class Worker:
    """Takes frames until the mailbox is closed and empty."""

    def __init__(
        self,
        mailbox: Mailbox,
        pipeline: Pipeline,
        replies: Replies,
        times: ServiceTime,
        deadline: Deadline,
        limits: BatchLimits,
        metrics: Metrics,
        clock: Clock,
    ) -> None:
        self._mailbox = mailbox
        self._pipeline = pipeline
        self._replies = replies
        self._times = times
        self._deadline = deadline
        self._limits = limits
        self._metrics = metrics
        self._clock = clock
        self._beat_ns = clock.now_ns()
        # A daemon: an inference that hangs must not keep the process from ending
        self._thread = threading.Thread(target=self.run, name="worker", daemon=True)

    @property
    def silent_ns(self) -> int:
        """How long ago the loop last came round."""
        return self._clock.now_ns() - self._beat_ns

    @property
    def expected_ns(self) -> int:
        """What a frame is expected to take now; 0: none was served of late."""
        return self._times.expected_ns(self._clock.now_ns())

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
            if arrival is not None and not self._drop(arrival):
                self._serve(self._gather(arrival))

    def _drop(self, arrival: Arrival) -> bool:
        """Whether a frame is of no use any more; then it is answered."""
        now_ns = self._clock.now_ns()
        ruling, prospect = self._deadline.rule(
            now_ns - arrival.t2_ns,
            arrival.packed.header.budget_ns,
            now_ns,
            is_try=arrival.is_try,
        )
        if ruling is not Ruling.DROP:
            return False
        self._metrics.dropped.labels("worker").inc()
        self._answer(arrival, prospect.dropped())
        return True

    def _gather(self, first: Arrival) -> list[Arrival]:
        """The batch that begins with ``first``, of different drones."""
        drones = {first.drone}

        def take_more(wait_ns: int, accept: Callable[[Arrival], bool]) -> Arrival | None:
            another = self._mailbox.take(
                wait_ns * 1e-9, lambda it: it.drone not in drones and accept(it)
            )
            if another is not None:
                drones.add(another.drone)
            return another

        return gather(
            first,
            take_more,
            lambda arrival: arrival.deadline_ns,
            lambda size: self._times.expected_ns(self._clock.now_ns(), size),
            self._limits,
            self._clock.now_ns,
        )

    def _serve(self, batch: list[Arrival]) -> None:
        """Work on frames and answer each as soon as it is done; what goes wrong is an outcome."""
        begun_ns = self._clock.now_ns()
        decoded: list[tuple[_Job, RgbdFrame]] = []
        for arrival in batch:
            job = _Job(arrival, {"queue": begun_ns - arrival.t2_ns})
            with self._own_fault(job):
                frame = self._pipeline.decode(arrival.packed, job.stages_ns)
                if isinstance(frame, Output):
                    self._answer(arrival, frame)
                else:
                    decoded.append((job, frame))
        if not decoded:
            return
        seen = self._pipeline.detect(
            [frame for _, frame in decoded], [job.stages_ns for job, _ in decoded]
        )
        # A picture that no detector takes cost next to nothing, and tells of no other
        taken = [what for what in seen if not isinstance(what, ImageError)]
        if taken:
            self._metrics.batch.observe(len(taken))
        for (job, frame), what in zip(decoded, seen, strict=True):
            with self._own_fault(job):
                self._answer(job.arrival, self._pipeline.conclude(frame, what, job.stages_ns))
        if taken and not any(isinstance(what, Exception) for what in taken):
            done_ns = self._clock.now_ns()
            self._times.note(len(taken), done_ns - begun_ns, done_ns)

    @contextmanager
    def _own_fault(self, job: _Job) -> Iterator[None]:
        """Answer the frame if anything goes wrong with it, and go on with the others."""
        try:
            yield
        except Exception as error:  # the process boundary: one frame must not end the service
            log.exception("frame failed", extra={"drone": job.arrival.drone})
            reason = bounded(type(error).__name__)
            self._answer(job.arrival, Output(Outcome.FAILED, reason, stages_ns=job.stages_ns))

    def _answer(self, arrival: Arrival, output: Output) -> None:
        self._replies.answer(arrival.packed.header, arrival.t2_ns, output)
