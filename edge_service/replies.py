"""Acks, echoes and results: how a worker's answers are made, stamped, counted and sent."""

from __future__ import annotations

import numpy as np

from edge_service.metrics import Metrics
from edge_service.pipeline import Found, Output
from edge_service.recent import Recent
from edge_service.transport import Transport
from rgbd_wire.clock import Clock
from rgbd_wire.messages import (
    MAX_POSE_NUMBER,
    Ack,
    FrameHeader,
    LevelBox,
    Result,
    TargetPose,
    pack_covariance,
    pose_numbers,
    seal_ack,
    seal_result,
)
from rgbd_wire.probe import Probe, seal_probe


class Replies:
    """Answers in the name of one start of one worker."""

    def __init__(
        self,
        worker: str,
        boot_id: int,
        model_hash: str,
        transport: Transport,
        metrics: Metrics,
        clock: Clock,
    ) -> None:
        self.worker = worker
        self.boot_id = boot_id
        self.model_hash = model_hash
        self.recent = Recent()
        """t3 - t2 of the frames that were looked at."""
        self._transport = transport
        self._metrics = metrics
        self._clock = clock
        self.draining = False
        """Said in every result from now on."""

    def ack(self, header: FrameHeader) -> None:
        """Tell a drone that its frame has arrived whole: exactly one result will follow."""
        ack = Ack(header.drone, header.boot_id, header.sequence, self.worker, self.boot_id)
        if not self._transport.send(header.drone, seal_ack(ack)):
            self._metrics.unsent.inc()

    def echo(self, drone: str, probe: Probe, t2_ns: int) -> None:
        """Send a probe back with this worker's two stamps."""
        echo = Probe(
            probe.boot_id,
            probe.sequence,
            probe.t1_ns,
            t2_ns=t2_ns,
            t3_ns=self._clock.now_ns(),
            worker_boot_id=self.boot_id,
        )
        if not self._transport.send(drone, seal_probe(echo)):
            self._metrics.unsent.inc()

    def answer(self, header: FrameHeader, t2_ns: int, output: Output) -> None:
        """Send the one result of a frame whose last byte came in at ``t2_ns``, worker's clock."""
        target = None if output.found is None else target_pose_message(output.found)
        t3_ns = self._clock.now_ns()
        result = Result(
            drone=header.drone,
            boot_id=header.boot_id,
            sequence=header.sequence,
            t_capture_ns=header.t_capture_ns,
            t1_ns=header.t1_ns,
            t2_ns=t2_ns,
            t3_ns=t3_ns,
            worker=self.worker,
            worker_boot_id=self.boot_id,
            outcome=output.outcome,
            reason=output.reason,
            target=target,
            stages_ns=output.stages_ns,
            model=self.model_hash,
            draining=self.draining,
        )
        if not self._transport.send(header.drone, seal_result(result)):
            self._metrics.unsent.inc()
        self._metrics.answered(output, t3_ns - t2_ns)
        if output.outcome.looked_at:
            self.recent.note(t3_ns - t2_ns)


def target_pose_message(found: Found) -> TargetPose:
    """A target as it goes over the wire."""
    localisation = found.localisation
    world = found.world_from_target
    if world is not None and np.abs(world.translation).max() > MAX_POSE_NUMBER:
        world = None  # the drone's own pose lies at the very edge of what the wire takes
    fold = localisation.alternative
    return TargetPose(
        camera_from_target=pose_numbers(localisation.camera_from_target),
        world_from_target=None if world is None else pose_numbers(world),
        covariance=pack_covariance(localisation.covariance),
        method=localisation.method.value,
        ambiguous=localisation.ambiguous,
        alternative=None if fold is None else pose_numbers(fold),
        score=float(found.candidate.score),
        boxes=tuple(
            LevelBox(
                level.value,
                float(box.x0),
                float(box.y0),
                float(box.x1),
                float(box.y1),
                float(box.score),
            )
            for level, box in found.candidate.boxes.items()
        ),
    )
