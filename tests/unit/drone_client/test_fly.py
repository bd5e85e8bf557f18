"""A whole flight in real time: camera, link, mission, filter, a vehicle that lags, a wall."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drone_client.airframe import Airframe
from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.simulated import SimulatedAutopilot
from drone_client.control import Decision, decide
from drone_client.errors import AutopilotError, LinkError, SourceError
from drone_client.flight_settings import flight_settings
from drone_client.fly.cockpit import View
from drone_client.fly.run import FlyOptions, fly
from drone_client.link.memory import MemoryLink
from drone_client.mission import Phase
from drone_client.odometry.source import OdometrySource
from drone_client.run_files import EVENTS_NAME, TICKS_NAME
from drone_client.settings import ClientSettings
from drone_client.source import Capture
from drone_client.summary_table import summary_rows
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import FrameHeader, pose_of
from tests.unit.drone_client.builders import CAMERA, answering, frame, pose, target_of

CLOCK = MonotonicClock()
AIRFRAME = Airframe()
WORLD_FROM_TARGET = pose((6, 1, 1.5), (0, 0, np.pi))
"""On a wall in the east; its x is the world's -x."""
START = (6 - 0.55 - 0.6, 1.06, 1.47)
"""Of the body: the tip 0.6 m before the board, 6 cm and 3 cm beside the axis."""
GIVES_WAY_M = 0.015
"""How far the arm can be pressed in before the vehicle stands."""
FRAME_S = 0.05


class AtTheWall(SimulatedAutopilot):
    """The simulated vehicle before a wall that it cannot fly through."""

    def __init__(self, **changes: Any) -> None:
        super().__init__(CLOCK, pose(START), **changes)
        self.commands: list[VelocityCommand] = []
        self.deepest_m = np.inf
        self.widest_touch_m = 0.0

    def command(self, command: VelocityCommand) -> None:
        self.commands.append(command)
        super().command(command)

    def _advance(self, wanted: Any, dt_s: float) -> None:
        super()._advance(wanted, dt_s)
        tip = self._position + (0.55 * np.cos(self._yaw_rad), 0.55 * np.sin(self._yaw_rad), 0)
        x = 6.0 - tip[0]
        if x < -GIVES_WAY_M:
            self._position = self._position - (-GIVES_WAY_M - x, 0.0, 0.0)
            self._velocity = np.minimum(self._velocity, (0.0, np.inf, np.inf))
        if x < 0:
            self.widest_touch_m = max(
                self.widest_touch_m, float(np.hypot(tip[1] - 1, tip[2] - 1.5))
            )
        self.deepest_m = min(self.deepest_m, x)


class PacedCamera:
    """A camera of 20 Hz; may be told to break."""

    camera = CAMERA

    def __init__(self) -> None:
        self.given = 0
        self.breaks = threading.Event()
        self.hangs = threading.Event()
        """It gives the last picture again and again, with new stamps."""
        self._stop = threading.Event()

    def start(self) -> None:
        """Nothing to open."""

    def captures(self, timeout_s: float) -> Iterator[Capture | None]:
        f = frame()
        color = f.color_rgb
        while not self._stop.wait(FRAME_S):
            if self.breaks.is_set():
                raise SourceError("the camera was pulled out")
            self.given += 1
            if not self.hangs.is_set():
                color = f.color_rgb.copy()
                color[0, 0] = self.given % 251  # as little as two exposures may differ by
            yield Capture(CLOCK.now_ns(), color.copy(), f.depth_units, str(self.given))

    def counts(self) -> dict[str, int]:
        return {"given": self.given}

    def stop(self) -> None:
        self._stop.set()


class Person:
    """Says yes or no, and acts when something has happened."""

    def __init__(self, answer: bool = True) -> None:
        self.answer = answer
        self.asked: list[View] = []
        self.told: list[str] = []
        self.on_view: Callable[[View], None] = lambda view: None

    def may_fly(self, view: View) -> bool:
        self.asked.append(view)
        return self.answer

    def show(self, view: View) -> None:
        self.on_view(view)

    def tell(self, sentence: str) -> None:
        self.told.append(sentence)


class Scene:
    """One flight, ready to begin."""

    def __init__(self, folder: Path, vehicle: SimulatedAutopilot | None = None) -> None:
        self.folder = folder
        self.vehicle = vehicle or AtTheWall()
        self.camera = PacedCamera()
        self.person = Person()
        self.sees = True
        self.settings = ClientSettings(wait_for_worker_s=0)
        parts = flight_settings(self.settings)
        mission = replace(
            parts.control.mission, standoff_m=0.4, seen_s=0.2, aligned_s=0.2, dwell_s=0.3
        )
        mission = replace(mission, attempts=1, hold_max_s=2.0)
        control = replace(parts.control, mission=mission, keep_outs=AIRFRAME.keep_outs)
        self.parts = replace(parts, control=control)
        self.link = MemoryLink(CLOCK, answering(self._look))

    def _look(self, header: FrameHeader):
        """What a good worker says of the true scene: the vehicle's pose is exact here."""
        if not self.sees or header.world_from_camera is None:
            return None
        seen = pose_of(header.world_from_camera).inverse() @ WORLD_FROM_TARGET
        return target_of(seen, np.diag([1e-7] * 6))

    def fly(self, odometry: OdometrySource | None = None, **options: Any) -> dict[str, Any]:
        """The summary; ``odometry``: of a robot that it flies beside."""
        try:
            return fly(
                self.camera,
                self.vehicle,
                AIRFRAME,
                self.settings,
                self.parts,
                FlyOptions(self.folder, plot=False, **options),
                self.link,
                CLOCK,
                self.person,
                odometry=odometry,
            )
        finally:
            names = {t.name for t in threading.enumerate()}
            assert not names & {"uplink", "control", "camera", "line writer"}

    def lines(self, name: str) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.folder / name).read_text().splitlines()]

    def phases(self) -> list[str]:
        return [e["after"] for e in self.lines(EVENTS_NAME) if e["event"] == "phase"]

    def when(self, phase: Phase, act: Callable[[], None], nearer_than_m: float = np.inf) -> None:
        """Act once, when the mission is in a phase and the tip within a distance."""
        done = threading.Event()

        def look(view: View) -> None:
            decision = view.decision
            if decision is None or decision.tip_target is None or done.is_set():
                return
            if decision.mission.phase is phase and decision.tip_target[0] < nearer_than_m:
                done.set()
                act()

        self.person.on_view = look


def test_it_flies_to_contact_and_comes_back(tmp_path):
    """Asked once, with the target seen; pressed inside the mouth; back, and given back."""
    scene = Scene(tmp_path)
    summary = scene.fly()
    assert (summary["phase"], summary["agreed"]) == ("done", True), scene.person.told
    assert not summary["broken_off"]
    assert scene.phases()[:2] == ["search", "align"]
    assert scene.phases()[-4:] == ["approach", "contact", "retreat", "done"]
    assert len(scene.person.asked) == 1
    assert summary_rows(summary)["mission"] == "done (back), 1 approach"
    assert scene.vehicle.mode == "AUTO.LOITER"
    assert -0.03 < scene.vehicle.deepest_m < 0
    assert scene.vehicle.widest_touch_m < 0.02
    assert all(np.linalg.norm(c.velocity_world) <= 0.4 + 1e-9 for c in scene.vehicle.commands)
    assert summary["control_errors"] == 0
    ticks = scene.lines(TICKS_NAME)
    assert {t["phase"] for t in ticks} >= {"align", "approach", "contact", "retreat", "done"}
    assert any("approach -> contact" in sentence for sentence in scene.person.told)


def test_without_a_yes_nothing_is_flown(tmp_path):
    """The vehicle stays in its pilot's mode; the run says why it ended."""
    scene = Scene(tmp_path)
    scene.person.answer = False
    summary = scene.fly()
    assert (summary["agreed"], scene.vehicle.mode) == (False, "POSCTL")
    assert not any(np.any(c.velocity_world) for c in scene.vehicle.commands)


@pytest.mark.parametrize("way", ["refused", "pilot"])
def test_a_vehicle_that_is_not_given_ends_the_flight(tmp_path, way, monkeypatch):
    """It gave up asking, or a pilot was quicker: nobody waits ten minutes for what never comes."""

    class Reluctant(AtTheWall):
        def engage(self) -> None:
            super().engage()
            self.mode = "POSCTL"

    scene = Scene(tmp_path, Reluctant() if way == "refused" else AtTheWall(armed=False))
    if way == "pilot":  # not armed: it obeys nobody, so the mission waits; then the mode changes

        def switch(view: View) -> None:
            scene.vehicle.mode = "ALTCTL"

        scene.person.on_view = switch
    summary = scene.fly()
    assert summary["phase"] == "hold"
    assert any("not taken" in told for told in scene.person.told)
    assert "not_taken" in {e["event"] for e in scene.lines(EVENTS_NAME)}
    assert all(not np.any(c.velocity_world) for c in scene.vehicle.commands)


def test_a_dry_run_sends_nothing(tmp_path):
    """The mission runs against the true state of a vehicle that hears no word of it."""
    scene = Scene(tmp_path)
    scene.person.on_view = interrupt_always(Phase.ALIGN, Phase.ABORT)
    summary = scene.fly(dry_run=True)
    assert summary["dry_run"]
    assert scene.vehicle.commands == []
    assert scene.vehicle.mode == "POSCTL"
    assert not scene.person.asked
    moving = [t for t in scene.lines(TICKS_NAME) if t["phase"] == "align"]
    assert any(np.any(np.abs(t["command_mps"]) > 0.01) for t in moving)


def interrupt() -> None:
    """Ctrl-C, as the main thread feels it."""
    raise KeyboardInterrupt


def interrupt_always(*phases: Phase) -> Callable[[View], None]:
    """Ctrl-C again and again."""

    def look(view: View) -> None:
        if view.decision is not None and view.decision.mission.phase in phases:
            raise KeyboardInterrupt

    return look


def test_an_interrupt_backs_off_and_gives_back(tmp_path):
    """Aborted by order; away from the board, then in the mode that holds."""
    scene = Scene(tmp_path)
    scene.when(Phase.APPROACH, interrupt, nearer_than_m=0.25)
    summary = scene.fly()
    assert (summary["phase"], summary["reason"]) == ("abort", "ordered_abort")
    assert summary["broken_off"]
    assert scene.vehicle.mode == "AUTO.LOITER"
    events = scene.lines(EVENTS_NAME)
    aborted_ns = next(e["t_ns"] for e in events if e.get("after") == "abort")
    after = [t for t in scene.lines(TICKS_NAME) if t["t_ns"] > aborted_ns]
    assert after
    assert scene.vehicle.deepest_m > 0
    assert after[-1]["tip_target_m"][0] > 0.3
    assert all(t["command_mps"][0] <= 1e-9 for t in after)


def test_a_second_interrupt_gives_back_at_once(tmp_path):
    """The drone stands where it is, in the mode that holds."""
    scene = Scene(tmp_path)

    def look(view: View) -> None:
        decision = view.decision
        if decision is None or decision.tip_target is None:
            return
        phase, near = decision.mission.phase, decision.tip_target[0] < 0.2
        if phase is Phase.ABORT or (phase is Phase.APPROACH and near):
            raise KeyboardInterrupt

    scene.person.on_view = look
    tell, modes = scene.person.tell, {}

    def told(sentence: str) -> None:
        tell(sentence)
        modes[sentence] = scene.vehicle.mode

    scene.person.tell = told
    before = time.monotonic()
    assert scene.fly()["broken_off"]
    assert modes["interrupted"] == "AUTO.LOITER"  # a terminal that hangs does not keep it
    assert time.monotonic() - before < 60
    assert scene.vehicle.mode == "AUTO.LOITER"


@pytest.mark.parametrize("phase", [Phase.ALIGN, Phase.APPROACH, Phase.CONTACT])
def test_a_pilot_who_takes_over_keeps_it(tmp_path, phase: Phase):
    """The mission ends at once, and the mode is never asked for again."""
    scene = Scene(tmp_path)
    scene.when(phase, lambda: setattr(scene.vehicle, "mode", "POSCTL"))
    summary = scene.fly()
    assert (summary["phase"], summary["reason"]) == ("abort", "pilot")
    assert scene.vehicle.mode == "POSCTL"


def test_a_camera_that_breaks_ends_in_a_retreat(tmp_path):
    """What is known grows old: no approach any more, and the vehicle is given back."""
    scene = Scene(tmp_path)
    scene.when(Phase.APPROACH, scene.camera.breaks.set)
    summary = scene.fly()
    assert summary["camera_error"] == "the camera was pulled out"
    assert summary["phase"] == "abort"
    assert scene.vehicle.mode == "AUTO.LOITER"
    assert scene.vehicle.deepest_m > 0


def test_a_camera_that_hangs_and_goes_on_giving_its_last_picture_ends_in_a_retreat(tmp_path):
    """Its pictures are stamped anew, and not one of them is sent: what is known grows old."""
    scene = Scene(tmp_path)
    scene.when(Phase.APPROACH, scene.camera.hangs.set, nearer_than_m=0.3)
    summary = scene.fly()
    assert summary["phase"] == "abort"
    assert summary["camera"]["frozen"] > 10
    events = [e["event"] for e in scene.lines(EVENTS_NAME)]
    assert events.count("camera_frozen") == 1
    assert any("same picture" in told for told in scene.person.told)
    assert "retreat" in scene.phases()
    assert scene.vehicle.deepest_m > 0.0


def test_a_camera_that_fails_in_a_way_nobody_thought_of_ends_in_a_retreat(tmp_path, caplog):
    """Likewise: told, written down, and no approach any more."""
    scene = Scene(tmp_path)
    captures = scene.camera.captures

    def failing(timeout_s: float) -> Iterator[Capture | None]:
        for capture in captures(timeout_s):
            if broken.is_set():
                raise RuntimeError("frame didn't arrive within 5000")
            yield capture

    broken = threading.Event()
    scene.camera.captures = failing
    scene.when(Phase.APPROACH, broken.set)
    summary = scene.fly()
    assert summary["camera_error"] == "frame didn't arrive within 5000"
    assert any("no more pictures: frame didn't" in sentence for sentence in scene.person.told)
    assert any(e["event"] == "camera_lost" for e in scene.lines(EVENTS_NAME))
    assert summary["phase"] == "abort"
    assert scene.vehicle.deepest_m > 0
    assert "the camera's thread failed" in caplog.text


@pytest.mark.parametrize("way", ["fails", "hangs"])
def test_a_control_loop_that_decides_nothing_any_more_ends_the_flight(tmp_path, way, monkeypatch):
    """No order would reach the mission: the vehicle is given back, and told why."""
    scene = Scene(tmp_path)
    stuck, over = threading.Event(), threading.Event()

    def decide_or_not(*args: Any) -> Decision:
        if stuck.is_set():
            if way == "fails":
                raise RuntimeError("at every tick")
            over.wait(60)
        return decide(*args)

    monkeypatch.setattr("drone_client.control_loop.decide", decide_or_not)
    given_back: list[str] = []
    release = scene.vehicle.release

    def released() -> None:
        release()
        given_back.append(scene.vehicle.mode)
        over.set()

    monkeypatch.setattr(scene.vehicle, "release", released)
    scene.when(Phase.APPROACH, stuck.set)
    summary = scene.fly()
    assert given_back[0] == "AUTO.LOITER"
    assert summary["phase"] != "done"
    assert "the control loop is stuck: the vehicle is given back" in scene.person.told
    assert any(e["event"] == "control_stuck" for e in scene.lines(EVENTS_NAME))


def test_a_camera_that_hangs_when_it_is_closed_does_not_keep_the_run(tmp_path, monkeypatch):
    """The ledger is closed and the summary written all the same."""
    monkeypatch.setattr("drone_client.fly.run.CLOSE_S", 0.05)
    scene = Scene(tmp_path)
    stop, over = scene.camera.stop, threading.Event()

    def hanging() -> None:
        stop()
        over.wait(60)

    scene.camera.stop = hanging
    scene.person.answer = False
    assert scene.fly()["agreed"] is False
    over.set()


def test_a_vehicle_that_does_not_know_where_it_is_is_not_taken(tmp_path):
    """One line that says so, and nothing is left running."""

    class Lost(AtTheWall):
        def state(self):
            return replace(super().state(), world_from_body=None)

    with pytest.raises(AutopilotError, match="does not say where it is"):
        Scene(tmp_path, Lost()).fly(wait_for_vehicle_s=0.1)


def test_the_pose_of_a_vehicle_is_carried_on_to_now():
    """By its velocity, for a moment; kept exactly, once, at its own time."""
    from drone_client.fly.vehicle_pose import MAX_AHEAD_NS, VehiclePose

    state = replace(
        AtTheWall().state(),
        t_pose_ns=1_000_000_000,
        velocity_world=np.array([0.1, 0, -0.2]),
    )
    kept: list[tuple[int, Pose]] = []
    here = VehiclePose(lambda: state, lambda t_ns, p: kept.append((t_ns, p)))
    for _ in range(2):
        later = here(1_050_000_000)
    np.testing.assert_allclose(later.translation, np.array(START) + (0.005, 0, -0.01))
    assert kept == [(1_000_000_000, state.world_from_body)]
    assert here(state.t_pose_ns + MAX_AHEAD_NS + 1) is None
    assert VehiclePose(lambda: None, lambda t_ns, p: None)(0) is None


def test_a_camera_that_is_not_there_is_one_line(tmp_path):
    """Nothing else was started, and nothing is left running."""
    scene = Scene(tmp_path)

    def start() -> None:
        raise SourceError("no camera")

    scene.camera.start = start
    with pytest.raises(SourceError, match="no camera"):
        scene.fly()
    assert scene.vehicle.mode == "POSCTL"
    assert scene.vehicle.commands == []


def test_nobody_answers_is_one_line(tmp_path):
    """No worker: the vehicle is not taken."""
    scene = Scene(tmp_path)
    scene.link = MemoryLink(CLOCK, answering(), workers=())
    with pytest.raises(LinkError, match="no worker answers"):
        scene.fly()
    assert scene.vehicle.mode == "POSCTL"
