"""A run of the client: the threads, and what they share.

::

    playback thread   capture -> uplink's one-slot mailbox
    uplink thread     mailbox -> encode -> link    (ack clock; watches the workers)
    link's thread     message -> receiver: gate -> target estimate   -> ledger
    control thread    pose, estimate -> guidance -> filter -> autopilot, at control_hz
    own eyes' thread  frames of the moments without the edge -> estimate   (on request)
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from drone_client.airframe import Airframe
from drone_client.autopilot import Autopilot
from drone_client.control import Decision
from drone_client.control_loop import ControlLoop, Knowledge
from drone_client.encoding_choice import EncodingChoice
from drone_client.flight_settings import FlightSettings
from drone_client.ledger import Fate, Ledger
from drone_client.link import Link
from drone_client.lookout import Lookout, LookoutSettings
from drone_client.mission import MissionState, Senses
from drone_client.onboard import LookVerdict
from drone_client.own_eyes import OwnEyes
from drone_client.reception import Receiver, Reception
from drone_client.records import decision_record, one_way_record, reception_record
from drone_client.tally import Tally
from drone_client.target import TargetEstimate
from drone_client.uplink import Uplink
from rgbd_wire.clock import Clock
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose

logger = logging.getLogger(__name__)


class Flight:
    """Owns receiver, uplink and the control thread; everything else is handed to it."""

    def __init__(
        self,
        settings: FlightSettings,
        airframe: Airframe,
        link: Link,
        autopilot: Autopilot,
        clock: Clock,
        ledger: Ledger,
        world_from_body: Callable[[int], Pose | None],
        on_accepted: Callable[[Reception], None] = lambda reception: None,
        *,
        mission: MissionState | None = None,
        senses: Callable[[int], Senses] = lambda now_ns: Senses(),
        on_decision: Callable[[Decision], None] = lambda decision: None,
    ) -> None:
        self.tally = Tally()
        self._settings = settings
        self._airframe = airframe
        self._camera_from_body = airframe.body_from_camera.inverse()
        self._link = link
        self._clock = clock
        self._ledger = ledger
        self._world_from_body = world_from_body
        self._on_accepted = on_accepted
        self._stopping = threading.Event()
        self._receiver = Receiver(
            settings.uplink.drone,
            settings.uplink.boot_id,
            settings.gate,
            airframe,
            on_heard=lambda sequence, worker, t_ns: self._uplink.heard(sequence, worker, t_ns),
            on_result=self._on_result,
            on_echo=lambda probe, t4_ns: self._uplink.echo(probe, t4_ns),
            on_status=lambda status: self._uplink.take_status(status),
            budget=settings.odometry.budget,
        )
        self._own_eyes = self._open_eyes()
        choice = EncodingChoice(settings.rate, lambda: self._receiver.estimate)
        self._uplink = Uplink(settings.uplink, link, clock, self._receiver, ledger, choice)
        self._control = ControlLoop(
            settings.control,
            airframe,
            autopilot,
            Knowledge(self._estimate, self._pose_now, senses),
            clock,
            ledger,
            self.tally,
            reply_timeout_ns=settings.reply_timeout_ns,
            mission=mission,
            on_decision=on_decision,
        )

    @property
    def receiver(self) -> Receiver:
        """For its counts."""
        return self._receiver

    @property
    def uplink(self) -> Uplink:
        """For what it knows of the workers."""
        return self._uplink

    @property
    def own_eyes(self) -> OwnEyes | None:
        """For their counts; None: the drone has none."""
        return self._own_eyes

    def _open_eyes(self) -> OwnEyes | None:
        eyes = self._settings.own_eyes
        if eyes is None:
            return None
        fresh_ns = self._settings.control.filter.age_max_ns
        return OwnEyes(
            eyes.target,
            Lookout(eyes.target, LookoutSettings(fresh_ns, max(fresh_ns, eyes.alone_max_ns))),
            lambda: self._receiver.word,
            self.camera_at,
            self._clock,
            self._on_look,
        )

    def _on_look(self, line: dict[str, Any]) -> None:
        self._ledger.look(line)
        self.tally.onboard += line["verdict"] == LookVerdict.ACCEPTED.value

    def camera_at(self, t_ns: int) -> Pose | None:
        """``world_from_camera`` at a time; None if the drone cannot know."""
        world_from_body = self._receiver.pose_at(t_ns)
        if world_from_body is None:
            return None
        return world_from_body @ self._airframe.body_from_camera

    def start(self) -> None:
        """Start receiving, sending and controlling."""
        self._link.start(self._on_message, self._uplink.wake)
        self._uplink.start()
        if self._own_eyes is not None:
            self._own_eyes.start()
        self._control.start()

    def capture(self, frame: RgbdFrame, name: str, *, brings_pose: bool = True) -> None:
        """Offer a frame to the workers.

        Args:
            frame: the pictures, with the camera's pose if it is known.
            name: what people call it.
            brings_pose: the pose was measured with the frame; else it is one that was kept here.
        """
        if brings_pose and frame.world_from_camera is not None:
            world_from_body = frame.world_from_camera @ self._camera_from_body
            self._receiver.add_pose(frame.t_capture_ns, world_from_body)
        sequence = self._uplink.submit(frame, name)
        if self._own_eyes is not None:
            self._own_eyes.offer(sequence, frame)

    def keep_pose(self, t_ns: int, world_from_body: Pose) -> None:
        """Keep where the drone was, for the measurements that will speak of that moment."""
        self._receiver.add_pose(t_ns, world_from_body)

    def drain(self) -> None:
        """Wait until each frame's fate is known; the time-outs bound it."""
        while self._ledger.under_way and not self._stopping.wait(0.01):
            pass

    def stop(self) -> None:
        """Stop all threads; the last command is to stand still."""
        self._stopping.set()
        self._uplink.stop()
        if self._own_eyes is not None:
            self._own_eyes.stop()
        self._control.stop()
        self._link.close()
        self._ledger.close()

    def _on_message(self, message: bytes, t4_ns: int) -> None:
        try:
            self._receiver.on_message(message, t4_ns)
        except Exception:
            # The link's thread is not ours to end: without it the drone would be deaf.
            if not self.tally.receive_errors:
                logger.exception("a message could not be handled")
            self.tally.receive_errors += 1

    def _on_result(self, reception: Reception) -> None:
        tally, result = self.tally, reception.result
        verdict = reception.judgement.verdict
        tally.verdicts[verdict.value] += 1
        self._uplink.answered(reception)
        if not verdict.settles_frame:
            self._ledger.event(
                reception.t4_ns,
                "refused_result",
                verdict=verdict.value,
                sequence=result.sequence,
                worker=result.worker,
            )
            return
        if not reception.settles and self._uplink.will_answer(reception.pending):
            self._ledger.event(
                reception.t4_ns,
                "waits_for_other_copy",
                verdict=verdict.value,
                sequence=result.sequence,
                worker=result.worker,
            )
            return
        tally.outcomes[result.outcome.value] += 1
        decision = self._control.decide(self._clock.now_ns())
        one_way = one_way_record(result, reception.t4_ns, self._uplink.estimate(result.worker))
        record = reception_record(reception) | one_way | decision_record(decision)
        if not self._ledger.close_frame(result.sequence, Fate.ANSWERED, record):
            tally.late_results += 1
            self._ledger.event(
                reception.t4_ns, "late_result", verdict=verdict.value, sequence=result.sequence
            )
        if reception.judgement.accepted:
            self._on_accepted(reception)  # last: whatever it does, the frame has its line

    def _estimate(self, now_ns: int) -> TargetEstimate | None:
        eyes = self._own_eyes
        return self._receiver.estimate if eyes is None else eyes.leading(now_ns)

    def _pose_now(self, now_ns: int) -> Pose | None:
        """Where the drone is: by its odometry, or where it was a moment ago."""
        world_from_body = self._world_from_body(now_ns)
        return self._receiver.pose_at(now_ns) if world_from_body is None else world_from_body
