"""The way down: message -> checks -> gate -> target in the world.

Runs on the link's thread. Nothing that comes from the network raises out of here: what is not a
valid message is counted under its reason.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drone_client.airframe import Airframe
from drone_client.gate import GateSettings, Judgement, ResultStamps, SentFrame, Verdict
from drone_client.pose_buffer import PoseBuffer
from drone_client.sent_frames import SentFrames
from drone_client.target import (
    MAX_VARIANCE,
    USUAL_BUDGET,
    OdometryBudget,
    TargetEstimate,
    TargetMeasurement,
    Update,
    measure,
    update,
)
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.errors import DecodeError, Reject
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import (
    Ack,
    Result,
    Status,
    TargetPose,
    decode_ack,
    decode_result,
    decode_status,
    pose_of,
    unpack_covariance,
)
from rgbd_wire.probe import Probe, decode_probe

LOST_NS = 40_000_000_000
"""A target that nobody has seen for longer was not near when the odometry jumped: longer than the
drone may fly by its own eyes (``onboard_max_s``), and back off after it."""
_MADE_UP = frozenset({Verdict.NEVER_SENT, Verdict.ECHO_MISMATCH, Verdict.WRONG_WORKER})
"""A result like this does not show that the worker has the frame: it frees no slot."""


@dataclass(frozen=True, slots=True, eq=False)
class Reception:
    """A result that came in, the gate's verdict on it, and what it did to the target."""

    result: Result
    t4_ns: int
    """Drone's clock."""
    judgement: Judgement
    update: Update | None
    """None: the gate refused it, or it has no target."""
    measurement: TargetMeasurement | None
    """In the world, as composed on board; None: no target, or the drone knew no pose, or the
    world was another."""
    pending: frozenset[str] = frozenset()
    """Workers that have a copy of the frame and have not answered it yet."""

    @property
    def world_from_target(self) -> Pose | None:
        """Of the measurement."""
        return None if self.measurement is None else self.measurement.world_from_target

    @property
    def settles(self) -> bool:
        """No better answer to this frame can come."""
        verdict = self.judgement.verdict
        return verdict.settles_frame and (self.judgement.accepted or not self.pending)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeWord:
    """The last that the edge has said of the target."""

    estimate: TargetEstimate | None
    """Where it is believed to be; None: not seen since the odometry's world began."""
    t_denied_ns: int | None
    """Exposure of the newest accepted frame in which a worker saw no target; None: none yet."""

    @property
    def denies(self) -> bool:
        """It looked again after it saw the target last, and saw none."""
        if self.estimate is None or self.t_denied_ns is None:
            return False
        return self.t_denied_ns > self.estimate.t_capture_ns


class Receiver:
    """Takes messages from the link; holds the target estimate and the drone's own past poses."""

    def __init__(
        self,
        drone: str,
        boot_id: int,
        gate: GateSettings,
        airframe: Airframe,
        on_heard: Callable[[int, str, int], None],
        on_result: Callable[[Reception], None],
        on_echo: Callable[[Probe, int], None] = lambda probe, t4_ns: None,
        on_status: Callable[[Status], None] = lambda status: None,
        *,
        budget: OdometryBudget = USUAL_BUDGET,
    ) -> None:
        """Take over the callbacks; all run on the link's thread.

        Args:
            drone: this drone's name.
            boot_id: of this start of the client.
            gate: the two bounds.
            airframe: where the camera is.
            on_heard: sequence, worker and time [ns, drone's clock] of an ack, or of a result that
                shows that its worker has the frame.
            on_result: every result for this drone, whatever the gate says of it.
            on_echo: a probe's echo, and when it came [ns, drone's clock].
            on_status: a worker's status.
            budget: how wrong the drone's own odometry may be.
        """
        self.rejects: Counter[Reject] = Counter()
        self.foreign = 0
        """Valid messages for another drone or another start of this one."""
        self._drone = drone
        self._boot_id = boot_id
        self._body_from_camera = airframe.body_from_camera
        self._on_heard = on_heard
        self._on_result = on_result
        self._on_echo = on_echo
        self._on_status = on_status
        self._budget = budget
        self._lock = threading.Lock()
        self._sent = SentFrames(gate)
        self._poses = PoseBuffer()
        self._estimate: TargetEstimate | None = None
        self._lost: TargetEstimate | None = None
        self._t_denied_ns: int | None = None

    @property
    def estimate(self) -> TargetEstimate | None:
        """Where the target is believed to be; None: not seen since the odometry's world began."""
        with self._lock:
            return self._estimate

    @property
    def lost(self) -> TargetEstimate | None:
        """What was known of the target when the odometry jumped, until it is measured again.

        In a world that is no more: it tells that the target may be near, and no place to fly by.
        """
        with self._lock:
            return self._lost

    @property
    def word(self) -> EdgeWord:
        """The last that the edge has said of the target."""
        with self._lock:
            return EdgeWord(self._estimate, self._t_denied_ns)

    def add_pose(self, t_ns: int, world_from_body: Pose) -> None:
        """The drone's own pose at a time on its clock."""
        with self._lock:
            self._poses.add(t_ns, world_from_body)

    def begin_epoch(self, t_ns: int) -> None:
        """The odometry jumped: what is known of the target does not hold in its new world.

        Args:
            t_ns: of the first pose that is told in it, drone's clock.
        """
        with self._lock:
            self._poses.begin_epoch(t_ns)
            known = self._estimate
            if known is not None:
                recent = t_ns - known.t_capture_ns <= LOST_NS
                self._lost, self._estimate = (known if recent else None), None

    def pose_at(self, t_ns: int) -> Pose | None:
        """``world_from_body`` at a time; None if the drone cannot know, or it was another world."""
        with self._lock:
            return self._poses.at(t_ns)

    def sending(self, frame: SentFrame) -> None:
        """A frame is about to leave."""
        with self._lock:
            self._sent.add(frame)

    def on_message(self, message: bytes, t4_ns: int) -> None:
        """Take a message that was complete at ``t4_ns``, drone's clock."""
        try:
            kind, body = unseal(message, Kind.RESULT, Kind.ACK, Kind.PROBE, Kind.STATUS)
            match kind:
                case Kind.ACK:
                    self._on_ack(decode_ack(body), t4_ns)
                case Kind.PROBE:
                    self._on_probe(decode_probe(body), t4_ns)
                case Kind.STATUS:
                    self._on_status(decode_status(body))
                case _:
                    self._on_answer(decode_result(body), t4_ns)
        except DecodeError as error:
            with self._lock:
                self.rejects[error.reason] += 1

    def _is_ours(self, message: Ack | Result) -> bool:
        ours = (message.drone, message.boot_id) == (self._drone, self._boot_id)
        if not ours:
            with self._lock:
                self.foreign += 1
        return ours

    def _on_probe(self, probe: Probe, t4_ns: int) -> None:
        if probe.boot_id == self._boot_id:
            self._on_echo(probe, t4_ns)
        else:
            with self._lock:
                self.foreign += 1

    def _on_ack(self, ack: Ack, t_ns: int) -> None:
        if not self._is_ours(ack):
            return
        with self._lock:
            known = self._sent.acknowledge(ack.sequence, ack.worker, ack.worker_boot_id)
        if known:
            self._on_heard(ack.sequence, ack.worker, t_ns)

    def _on_answer(self, result: Result, t4_ns: int) -> None:
        if not self._is_ours(result):
            return
        with self._lock:
            judgement = self._sent.judge(
                result.sequence,
                ResultStamps(
                    worker=result.worker,
                    worker_boot_id=result.worker_boot_id,
                    t_capture_ns=result.t_capture_ns,
                    t1_ns=result.t1_ns,
                    t2_ns=result.t2_ns,
                    t3_ns=result.t3_ns,
                    t4_ns=t4_ns,
                ),
                looked_at=result.outcome.looked_at,
            )
            pending = self._sent.unanswered(result.sequence)
            done, measurement = None, None
            if judgement.accepted and result.target is not None:
                done, measurement = self._fuse(result.target, result.t_capture_ns)
            elif judgement.accepted:
                self._t_denied_ns = result.t_capture_ns
        if judgement.verdict not in _MADE_UP:
            self._on_heard(result.sequence, result.worker, t4_ns)
        self._on_result(Reception(result, t4_ns, judgement, done, measurement, pending))

    def _fuse(
        self, target: TargetPose, t_capture_ns: int
    ) -> tuple[Update, TargetMeasurement | None]:
        located = self._poses.find(t_capture_ns)
        if located is None:
            return Update.NO_POSE, None
        if located.epoch != self._poses.epoch:
            return Update.BEFORE_JUMP, None
        measurement = measure(
            located.pose @ self._body_from_camera,
            pose_of(target.camera_from_target),
            unpack_covariance(target.covariance),
            t_capture_ns,
            epoch=located.epoch,
            budget=self._budget,
        )
        if target.ambiguous:
            return Update.AMBIGUOUS, measurement
        if np.trace(measurement.covariance) > MAX_VARIANCE:
            return Update.TOO_UNSURE, measurement
        self._estimate, done = update(self._estimate, measurement, self._budget)
        self._lost = None
        return done, measurement
