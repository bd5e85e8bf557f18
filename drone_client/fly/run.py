"""One flight: camera, link, control and vehicle, brought up in order and always taken down."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from drone_client.airframe import Airframe
from drone_client.autopilot import FlyingAutopilot
from drone_client.control import Decision
from drone_client.errors import AutopilotError, SourceError
from drone_client.flight import Flight
from drone_client.flight_settings import FlightSettings
from drone_client.fly.cockpit import Cockpit, View
from drone_client.fly.dry_run import Unheard
from drone_client.fly.feed_on import FeedOn
from drone_client.fly.orders import Orders
from drone_client.fly.vehicle_pose import VehiclePose
from drone_client.ledger import Ledger
from drone_client.link import Link
from drone_client.link.waiting import wait_for_worker
from drone_client.mission import Order, Senses, begin
from drone_client.odometry.feed import OdometryFeed
from drone_client.odometry.jump import Jump
from drone_client.odometry.source import OdometrySource
from drone_client.promptness import yield_soon
from drone_client.reception import Reception
from drone_client.run_report import report, take_down
from drone_client.settings import ClientSettings
from drone_client.source import Capture, LiveSource
from drone_client.source.frozen import FrozenWatch
from rgbd_wire.clock import Clock
from rgbd_wire.frame import RgbdFrame

logger = logging.getLogger(__name__)
PICTURE_S: Final = 0.2
"""How often a camera without a picture is asked whether the run is over."""
LOOK_S: Final = 0.1
"""How often the person in charge is shown how things are."""
LEAVE_S: Final = 1.0
"""Time for the vehicle to take the mode that it is given back in."""
STUCK_NS: Final = 2_000_000_000
"""Without a decision for so long the control loop hangs, or fails at every tick."""
CLOSE_S: Final = 5.0
"""Time for a camera to close; its driver may hang."""


@dataclass(frozen=True, slots=True)
class FlyOptions:
    """What the command line says of one flight."""

    out: Path
    dry_run: bool = False
    """Nothing is sent to the vehicle; the commands are only shown."""
    wait_for_vehicle_s: float = 10.0
    plot: bool = True
    overwrite: bool = False
    """An earlier run in ``out`` may go."""
    feeds_on: bool = False
    """What the robot's VIO says is passed on until the motors stand still: nobody else may."""


class _Run:
    """The parts of one flight and the threads between them."""

    def __init__(
        self,
        source: LiveSource,
        vehicle: FlyingAutopilot,
        airframe: Airframe,
        parts: FlightSettings,
        link: Link,
        clock: Clock,
        ledger: Ledger,
        on_accepted: Callable[[Reception], None],
        odometry: OdometrySource | None,
    ) -> None:
        self.orders = Orders()
        self.broken_off = False
        """By a person: Ctrl-C, SIGTERM, a terminal that was closed."""
        self.over = threading.Event()
        """The mission has given the vehicle back."""
        self.sentences: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.decision: Decision | None = None
        self.camera_error: Exception | None = None
        self._source = source
        self._vehicle = vehicle
        self._clock = clock
        self._ledger = ledger
        self._frozen = FrozenWatch()
        self._was_frozen = False
        self._stopping = threading.Event()
        self._pump = threading.Thread(target=self._run_pump, name="camera", daemon=True)
        believed = parts.odometry
        self.feed = (
            None
            if odometry is None
            else OdometryFeed(
                odometry, vehicle, self._on_vio_jump, believed.vio_jump, believed.lidar
            )
        )
        self._pose = VehiclePose(
            vehicle.state,
            lambda t_ns, pose: self.flight.keep_pose(t_ns, pose),
            self._on_jump,
            believed.jump,
        )
        self.flight = Flight(
            parts,
            airframe,
            link,
            vehicle,
            clock,
            ledger,
            self._pose,
            on_accepted,
            mission=begin(clock.now_ns()),
            senses=self._senses,
            on_decision=self._on_decision,
        )

    def start(self) -> None:
        self._source.start()
        self.flight.start()
        self._pump.start()

    @property
    def frozen_pictures(self) -> int:
        """Pictures that were not sent, as they were the same as the one before."""
        return self._frozen.frozen

    @property
    def has_begun(self) -> bool:
        """Whether the vehicle has been ours."""
        mission = None if self.decision is None else self.decision.mission
        return mission is not None and mission.begun_ns is not None

    def is_stuck(self, since_ns: int) -> bool:
        """Whether nothing was decided for too long, which no order could end.

        Args:
            since_ns: what was before does not count.
        """
        if self.decision is not None:
            since_ns = max(since_ns, self.decision.command.t_ns)
        return self._clock.now_ns() - since_ns > STUCK_NS

    def stop(self) -> None:
        self._stopping.set()
        closing = threading.Thread(target=self._source.stop, name="camera closing", daemon=True)
        closing.start()
        closing.join(timeout=CLOSE_S)
        if self._pump.is_alive():
            self._pump.join(timeout=5.0)

    def _run_pump(self) -> None:
        try:
            for capture in self._source.captures(PICTURE_S):
                if self._stopping.is_set():
                    return
                if capture is None or self._is_frozen(capture):
                    continue
                frame = RgbdFrame(
                    color_rgb=capture.color_rgb,
                    depth_units=capture.depth_units,
                    camera=self._source.camera,
                    t_capture_ns=capture.t_source_ns,
                    world_from_camera=self.flight.camera_at(capture.t_source_ns),
                )
                self.flight.capture(frame, capture.name, brings_pose=False)
        except Exception as error:
            # What is known grows old now, and that ends the approach; nothing else has to.
            if not isinstance(error, SourceError):
                logger.exception("the camera's thread failed")
            self.camera_error = error
            self.sentences.put(f"no more pictures: {error}")
            self._ledger.event(self._clock.now_ns(), "camera_lost", error=str(error))

    def _is_frozen(self, capture: Capture) -> bool:
        """Whether it is the last picture again; told once for each time that it begins."""
        if not self._frozen.see(capture.color_rgb):
            self._was_frozen = False
            return False
        if not self._was_frozen:
            self._was_frozen = True
            self.sentences.put("the camera gives the same picture again: it is not sent")
            self._ledger.event(self._clock.now_ns(), "camera_frozen", capture=capture.name)
        return True

    def _senses(self, now_ns: int) -> Senses:
        # a vehicle that hears nothing of us obeys nobody, and is flown as if there were none
        heard = None if isinstance(self._vehicle, Unheard) else self._vehicle.state()
        forward_m = None if self.feed is None else self.feed.tick(now_ns)
        jumped = self._pose.jumped(now_ns) or self.flight.receiver.lost is not None
        silent = self.feed is not None and self.feed.silent(now_ns)
        return Senses(
            heard,
            odometry_silent=silent,
            odometry_jumped=jumped,
            forward_m=forward_m,
            order=self.orders.now,
        )

    def _on_jump(self, jump: Jump) -> None:
        self._take_jump("odometry_jumped", jump)

    def _on_vio_jump(self, jump: Jump) -> None:
        # the autopilot's estimator is told of it, and its pose is about to follow
        self._take_jump("vio_jumped", jump)

    def _take_jump(self, event: str, jump: Jump) -> None:
        self.flight.receiver.begin_epoch(jump.t_ns)
        self.sentences.put(jump.sentence)
        self._ledger.event(
            self._clock.now_ns(),
            event,
            reason=jump.reason.value,
            t_pose_ns=jump.t_ns,
            sentence=jump.sentence,
        )

    def _on_decision(self, decision: Decision) -> None:
        self.decision = decision
        mission, intent = decision.mission, decision.intent
        if mission is not None and (change := mission.transition) is not None:
            self.sentences.put(f"{change.before} -> {change.after}: {change.sentence}")
            self._ledger.event(
                self._clock.now_ns(),
                "phase",
                before=change.before.value,
                after=change.after.value,
                reason=change.reason.value,
                sentence=change.sentence,
            )
        if intent is not None and intent.give_back and not self.over.is_set():
            self._vehicle.release()
            self.over.set()


def fly(
    source: LiveSource,
    vehicle: FlyingAutopilot,
    airframe: Airframe,
    settings: ClientSettings,
    parts: FlightSettings,
    options: FlyOptions,
    link: Link,
    clock: Clock,
    cockpit: Cockpit,
    on_accepted: Callable[[Reception], None] = lambda reception: None,
    odometry: OdometrySource | None = None,
    more: Callable[[], dict[str, Any]] = dict,
) -> dict[str, Any]:
    """Fly one mission; returns the summary, which is also written beside ledger and plot.

    What the robot's own VIO and lidars say (``odometry``) is passed on to the autopilot. What else
    stands in the summary is asked for at the end (``more``).

    An interrupt (Ctrl-C) aborts the mission: the drone backs off and is given back. A second one
    gives it back at once.

    Raises:
        ClientError: the output folder cannot be written, there is no camera, no worker or no
            vehicle.
    """
    yield_soon()
    if options.dry_run:
        vehicle = Unheard(vehicle)
        control = replace(
            parts.control, mission=replace(parts.control.mission, needs_vehicle=False)
        )
        parts = replace(parts, control=control)
    ledger = Ledger(options.out, overwrite=options.overwrite, own_eyes=settings.onboard_fallback)
    run = _Run(source, vehicle, airframe, parts, link, clock, ledger, on_accepted, odometry)
    after = FeedOn(
        run.feed if options.feeds_on and not options.dry_run else None,
        vehicle,
        clock,
        cockpit.tell,
        lambda: cockpit.show(View(vehicle.state(), None, run.flight.tally, ())),
    )
    agreed, at_end = False, {}
    with after:
        try:
            run.start()
            workers = wait_for_worker(link, settings)
            ledger.event(clock.now_ns(), "workers", live=workers)
            _wait_for_vehicle(vehicle, options)
            agreed = options.dry_run or cockpit.may_fly(_view(run, vehicle, link))
            if agreed:
                ledger.event(clock.now_ns(), "agreed", dry_run=options.dry_run)
                run.orders.give(Order.GO)
                vehicle.engage()
                if (why := _watch(run, vehicle, link, cockpit, clock.now_ns())) is not None:
                    run.sentences.put(why.sentence)
                    ledger.event(clock.now_ns(), why.event, sentence=why.sentence)
        except KeyboardInterrupt:
            vehicle.release()  # before a word: a terminal may take its time
            run.broken_off = True
            cockpit.tell("interrupted")
        finally:
            vehicle.release()
            run.over.wait(LEAVE_S)
            after.begin()
            run.stop()
            at_end = take_down(run.flight, link)
            _tell_all(run, cockpit)
        mission = None if run.decision is None else run.decision.mission
        about = {
            "agreed": agreed,
            "dry_run": options.dry_run,
            "broken_off": run.broken_off,
            "phase": None if mission is None else mission.phase.value,
            "reason": None if mission is None else mission.reason.value,
            "attempts": 0 if mission is None else mission.attempts,
            "camera": source.counts() | {"frozen": run.frozen_pictures},
            "camera_error": None if run.camera_error is None else str(run.camera_error),
            **({} if run.feed is None else {"odometry": run.feed.counts()}),
            **at_end,
            **more(),
        }
        return report(options.out, settings, run.flight, ledger, about, plot=options.plot)


class _NoEnd(NamedTuple):
    """Why a mission will never give the vehicle back by itself."""

    event: str
    sentence: str


def _watch(
    run: _Run, vehicle: FlyingAutopilot, link: Link, cockpit: Cockpit, since_ns: int
) -> _NoEnd | None:
    """Until the mission has given the vehicle back, or never will."""
    reason = ""
    while True:
        try:
            while not run.over.wait(LOOK_S):
                if vehicle.reason != reason:
                    reason = vehicle.reason
                    run.sentences.put(f"autopilot: {reason or 'the vehicle flies our commands'}")
                _tell_all(run, cockpit)
                cockpit.show(_view(run, vehicle, link))
                if run.is_stuck(since_ns):
                    return _NoEnd(
                        "control_stuck", "the control loop is stuck: the vehicle is given back"
                    )
                if vehicle.idle and not run.has_begun:
                    return _NoEnd("not_taken", f"the vehicle was not taken: {vehicle.reason}")
            return None
        except KeyboardInterrupt:
            if run.orders.now is Order.ABORT:
                raise
            run.orders.give(Order.ABORT)
            run.broken_off = True
            cockpit.tell("abort: backing off; once more to give the vehicle back at once")


def _tell_all(run: _Run, cockpit: Cockpit) -> None:
    while True:
        try:
            cockpit.tell(run.sentences.get_nowait())
        except queue.Empty:
            return


def _view(run: _Run, vehicle: FlyingAutopilot, link: Link) -> View:
    return View(vehicle.state(), run.decision, run.flight.tally, link.workers())


def _wait_for_vehicle(vehicle: FlyingAutopilot, options: FlyOptions) -> None:
    """Until it says where it is.

    Raises:
        AutopilotError: it does not, in time.
    """
    timeout_s = options.wait_for_vehicle_s
    give_up = time.monotonic() + timeout_s
    while True:
        state = vehicle.state()
        if state is not None and state.world_from_body is not None:
            return
        if time.monotonic() >= give_up:
            break
        time.sleep(0.02)
    if state is None:
        raise AutopilotError(
            f"no heartbeat of an autopilot within {timeout_s:g} s: is --autopilot right, and does "
            "the autopilot send to this machine?"
        )
    raise AutopilotError(
        f"the autopilot ({state.mode}) does not say where it is within {timeout_s:g} s: its "
        "estimator has no position; see drone-client doctor"
        + ("; a dry run passes no VIO on to it (--vio-topic)" if options.dry_run else "")
    )
