"""The way of a frame in lockstep: link, worker, link, and back into the client's gate.

Every answer goes through the client's real ``Receiver`` as the bytes that a worker sends, with
stamps of simulated time.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np

from contact_sim.lockstep.eyes import Eyes, Look, Sizes
from contact_sim.lockstep.link_model import LinkModel
from contact_sim.lockstep.sender import Leaving
from drone_client.gate import SentFrame
from drone_client.reception import Receiver
from rgbd_wire.messages import Ack, Result, seal_ack, seal_result

NAME: Final = "worker"
BOOT_ID: Final = 7
RESULT_BYTES: Final = 700
WORKER_EPOCH_NS: Final = 5_000_000_000_000
"""The worker's clock has a zero of its own."""


@dataclass(frozen=True, slots=True)
class WorkerSettings:
    """How long it takes."""

    work_ns: int = 45_000_000
    """Median of decode, detection and localisation."""
    spread: float = 0.25
    """Standard deviation of the logarithm of that."""


class RemoteWorker:
    """Frames in, answers out, in order of arrival."""

    def __init__(
        self,
        eyes: Eyes,
        link: LinkModel,
        receiver: Receiver,
        drone: str,
        boot_id: int,
        rng: np.random.Generator,
        settings: WorkerSettings | None = None,
    ) -> None:
        self.killed_ns: int | None = None
        """When it was killed: from then on it answers nothing."""
        self.hangs = False
        """A worker that hangs takes frames and answers none."""
        self.clock_step_ns = 0
        """By how much its clock was set."""
        self.counts: Counter[str] = Counter()
        self._eyes = eyes
        self._link = link
        self._receiver = receiver
        self._drone = drone
        self._boot_id = boot_id
        self._rng = rng
        self._settings = settings or WorkerSettings()
        self._sequence = 0
        self._busy_until_ns = 0
        self._leaving: list[tuple[int, int, int, bytes]] = []
        """When each message leaves, its number, which keeps them in order, and its size: a result
        that is worked on leaves after the acks of frames that come meanwhile."""
        self._arrivals: list[tuple[int, int, int, bytes]] = []
        """When each message arrives and left, and its number, which keeps them in order."""

    def kill(self, now_ns: int | None) -> None:
        """Kill it; None: it is there again."""
        self.killed_ns = now_ns

    def send(self, leaving: Leaving) -> tuple[int, Sizes]:
        """A frame leaves: it is sent, looked at and answered, as far as it gets.

        Returns:
            Its number, and what it weighs: ``Look.sizes``.
        """
        s = self._settings
        sequence, self._sequence = self._sequence, self._sequence + 1
        frame, t1_ns = leaving.exposed.frame, leaving.t1_ns
        t_capture_ns = frame.t_capture_ns
        self.counts["sent"] += 1
        look = self._eyes.look(frame, leaving.exposed.camera_from_target, leaving.chosen)
        # Chance is drawn alike whatever becomes of the frame: faults change nothing else
        work_ns = round(s.work_ns * float(np.exp(s.spread * self._rng.standard_normal())))
        self._receiver.sending(SentFrame(sequence, t_capture_ns, t1_ns, NAME))
        up = self._link.up.send(look.sizes.message, t1_ns)
        if up.arrives_ns is None or self.killed_ns is not None:
            self.counts["lost"] += 1
            return sequence, look.sizes
        ack = seal_ack(Ack(self._drone, self._boot_id, sequence, NAME, BOOT_ID))
        self._pass_down(ack, up.arrives_ns, 100)
        if self.hangs:
            self.counts["hung"] += 1
            return sequence, look.sizes
        begins_ns = max(up.arrives_ns, self._busy_until_ns)
        self._busy_until_ns = begins_ns + work_ns
        result = self._result(
            sequence, t_capture_ns, t1_ns, up.arrives_ns, self._busy_until_ns, look
        )
        self._pass_down(seal_result(result), self._busy_until_ns, RESULT_BYTES)
        return sequence, look.sizes

    def deliver(self, now_ns: int) -> None:
        """Hand the client what has arrived by now."""
        while self._leaving and self._leaving[0][0] <= now_ns:
            left_ns, number, size_bytes, message = heapq.heappop(self._leaving)
            down = self._link.down.send(size_bytes, left_ns)
            if down.arrives_ns is None:
                self.counts["answers_lost"] += 1
            else:
                heapq.heappush(self._arrivals, (down.arrives_ns, number, left_ns, message))
        while self._arrivals and self._arrivals[0][0] <= now_ns:
            t4_ns, _, left_ns, message = heapq.heappop(self._arrivals)
            was_killed = self.killed_ns is not None and left_ns > self.killed_ns
            if was_killed or self._link.down.cut:
                self.counts["answers_lost"] += 1
                continue
            self._receiver.on_message(message, t4_ns)

    def _pass_down(self, message: bytes, leaves_ns: int, size_bytes: int) -> None:
        self.counts["messages"] += 1
        number = self.counts["messages"]
        heapq.heappush(self._leaving, (leaves_ns, number, size_bytes, message))

    def _result(
        self, sequence: int, t_capture_ns: int, t1_ns: int, t2_ns: int, t3_ns: int, look: Look
    ) -> Result:
        return Result(
            drone=self._drone,
            boot_id=self._boot_id,
            sequence=sequence,
            t_capture_ns=t_capture_ns,
            t1_ns=t1_ns,
            t2_ns=t2_ns + WORKER_EPOCH_NS + self.clock_step_ns,
            t3_ns=t3_ns + WORKER_EPOCH_NS + self.clock_step_ns,
            worker=NAME,
            worker_boot_id=BOOT_ID,
            outcome=look.outcome,
            reason="" if look.target is not None else look.outcome.value,
            target=look.target,
            stages_ns={},
            model="",
            draining=False,
        )
