"""A whole run over a link without a network: every frame has its line, whatever goes wrong."""

from __future__ import annotations

import json
import logging
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from drone_client.airframe import Airframe
from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.memory import MemoryAutopilot
from drone_client.errors import LinkError, SourceError
from drone_client.flight import Flight
from drone_client.flight_settings import FlightSettings, OdometrySettings, flight_settings
from drone_client.ledger import Fate, Ledger
from drone_client.link.memory import MemoryLink
from drone_client.link.waiting import wait_for_worker
from drone_client.replay import ReplayOptions, replay
from drone_client.run_files import EVENTS_NAME, LEDGER_NAME, SUMMARY_NAME, TICKS_NAME
from drone_client.settings import ClientSettings
from drone_client.source import Capture
from drone_client.source.memory import MemorySource
from drone_client.target import OdometryBudget
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.frame_codec import unpack
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import FrameHeader, pose_of, seal_ack, seal_result
from tests.unit.drone_client.builders import (
    CAMERA,
    MS,
    ack_of,
    answering,
    eventually,
    frame,
    pose,
    result_of,
    target_of,
)

AIRFRAME = Airframe()
CLOCK = MonotonicClock()
WORLD_FROM_TARGET = pose((6, 1, 1.5), (0, 0, np.pi))
LOOKING_EAST = AIRFRAME.body_from_camera.rotation


def camera_at(x: float, y: float) -> Pose:
    """A camera that looks east, towards the target."""
    return Pose.from_rotation(LOOKING_EAST, np.array([x, y, 1.5]))


def sees(header: FrameHeader):
    """What a perfect worker answers: the target, from where the camera was."""
    return target_of(pose_of(header.world_from_camera).inverse() @ WORLD_FROM_TARGET)


def recording(count: int, gap_ms: int = 33) -> MemorySource:
    """Captures from places that jump to and fro, so that a wrong pose is a wrong target."""
    f = frame()
    captures, trajectory = [], []
    for i in range(count):
        t_ns = i * gap_ms * MS
        captures.append(Capture(t_ns, f.color_rgb, f.depth_units, f"{i}.png"))
        trajectory.append((t_ns, camera_at(2 + 0.1 * i, 0.5 * (-1) ** i)))
    return MemorySource(CAMERA, captures, trajectory)


def patient(**changes) -> ClientSettings:
    """Settings under which a busy machine makes no frame late."""
    slow = {"tau_max_ms": 9e3, "age_max_ms": 9e3, "ack_timeout_ms": 9e3, "reply_timeout_ms": 5e4}
    return ClientSettings(**(slow | {"control_hz": 200, "wait_for_worker_s": 0} | changes))


def lines(folder: Path, name: str = LEDGER_NAME) -> list[dict]:
    return [json.loads(line) for line in (folder / name).read_text().splitlines()]


def no_thread_is_left() -> bool:
    return not [t for t in threading.enumerate() if t.name in ("uplink", "control")]


def flown(
    folder: Path,
    source: MemorySource,
    on_progress: Callable = lambda done, tally: None,
    fast: bool = True,
    plot: bool = False,
    link: MemoryLink | None = None,
) -> dict:
    """The summary of a replay; every thread is gone after it."""
    link = link or MemoryLink(CLOCK, answering(sees))
    options = ReplayOptions(folder, fast, plot=plot)
    try:
        return replay(source, AIRFRAME, patient(), options, link, CLOCK, on_progress)
    finally:
        assert no_thread_is_left()


class Rig:
    """A flight over a memory link, with the messages that went out kept."""

    def __init__(
        self,
        folder: Path,
        answer: Callable[[str, bytes], Sequence[bytes]] = lambda worker, message: (),
        autopilot: MemoryAutopilot | None = None,
        world_from_body: Callable[[int], Pose | None] = lambda now_ns: None,
        parts: FlightSettings | None = None,
        **changes,
    ) -> None:
        self.folder = folder
        self.sent: list[bytes] = []
        self.autopilot = autopilot or MemoryAutopilot()
        self.ledger = Ledger(folder)
        self.deliver: Callable[[bytes], None] = lambda message: None

        def answer_and_keep(worker: str, message: bytes) -> Sequence[bytes]:
            self.sent.append(message)
            return answer(worker, message)

        link = MemoryLink(CLOCK, answer_and_keep)
        self.flight = Flight(
            parts or flight_settings(patient(**changes)),
            AIRFRAME,
            link,
            self.autopilot,
            CLOCK,
            self.ledger,
            world_from_body,
        )
        self.deliver = lambda message: self.flight.receiver.on_message(message, CLOCK.now_ns())

    def __enter__(self) -> Rig:
        self.flight.start()
        return self

    def __exit__(self, *_) -> None:
        self.flight.stop()
        assert no_thread_is_left()

    def capture(self) -> FrameHeader:
        """Send a frame; returns its header once it is on its way."""
        count = len(self.sent)
        self.flight.capture(frame(CLOCK.now_ns(), camera_at(3, 1)), "x.png")
        assert eventually(lambda: len(self.sent) > count)
        return unpack(self.sent[-1]).header


def test_as_fast_as_possible_every_frame_is_answered_and_composed_at_its_own_place(tmp_path):
    """The camera jumps between frames; each measurement gives the one true target all the same."""
    progress: list[int] = []
    summary = flown(tmp_path, recording(12), lambda done, tally: progress.append(done), plot=True)
    frames = lines(tmp_path)
    assert [f["sequence"] for f in frames] == list(range(12))
    assert [f["name"] for f in frames] == [f"{i}.png" for i in range(12)]
    assert {f["verdict"] for f in frames} == {"accepted"}
    assert [f["update"] for f in frames] == ["first"] + ["fused"] * 11
    for f in frames:
        np.testing.assert_allclose(
            pose_of(tuple(f["world_from_target"])).matrix, WORLD_FROM_TARGET.matrix, atol=1e-6
        )
    assert summary["accepted_poses"] == 12
    assert summary["fates"] == {"answered": 12}
    assert (summary["interrupted"], summary["as_fast_as_possible"]) == (False, True)
    assert (summary["lost_ledger_lines"], summary["control_errors"]) == (0, 0)
    assert json.loads((tmp_path / SUMMARY_NAME).read_text()) == summary
    assert (tmp_path / "run.png").stat().st_size > 10_000
    assert progress == [*range(1, 13), 12]


def test_at_real_speed_ticks_go_on_between_frames(tmp_path):
    """Each tick has its line; once the target is known the filter is asked at its age."""
    summary = flown(tmp_path, recording(6), fast=False)
    assert sum(summary["fates"].values()) == 6
    ticks = lines(tmp_path, TICKS_NAME)
    assert summary["ticks"] == len(ticks)
    times = [t["t_ns"] for t in ticks]
    assert times == sorted(times)
    known = [t for t in ticks if t["known"] == "target"]
    assert known
    assert all(t["target_age_ms"] > 0 and t["h_m"] is not None for t in known)


def test_an_interrupt_leaves_a_whole_ledger_and_a_summary(tmp_path):
    """Ctrl-C in mid-replay: each captured frame has its line, and the summary says so."""

    def on_progress(done: int, tally: object) -> None:
        if done == 4:
            raise KeyboardInterrupt

    summary = flown(tmp_path, recording(50), on_progress)
    assert summary["interrupted"] is True
    frames = lines(tmp_path)
    assert sorted(f["sequence"] for f in frames) == [0, 1, 2, 3]
    assert Counter(f["fate"] for f in frames) == summary["fates"]
    assert summary["fates"]["answered"] >= 3
    assert json.loads((tmp_path / SUMMARY_NAME).read_text()) == summary


def test_an_interrupt_while_frames_are_under_way_tells_them_interrupted(tmp_path):
    """A link that never answers: what was sent and what waited is in the ledger."""

    def on_progress(done: int, tally: object) -> None:
        if done == 5:
            raise KeyboardInterrupt

    silent = MemoryLink(CLOCK, lambda worker, message: ())
    summary = flown(tmp_path, recording(50, gap_ms=1), on_progress, fast=False, link=silent)
    fates = summary["fates"]
    assert sum(fates.values()) == 5
    assert fates["interrupted"] + fates.get("superseded_on_board", 0) == 5


def test_without_a_worker_a_replay_ends_in_one_line_and_leaves_nothing_running(tmp_path):
    """Where it looked, how long, and what to do."""
    with pytest.raises(LinkError, match=r"no worker answers at tcp/.* is edge-service running"):
        flown(tmp_path, recording(3), link=MemoryLink(CLOCK, answering(), workers=()))
    assert lines(tmp_path) == []


def test_a_picture_that_breaks_in_mid_flight_leaves_a_whole_ledger(tmp_path):
    """The frames before it have their lines."""

    class Breaking(MemorySource):
        def captures(self):
            for i, capture in enumerate(super().captures()):
                if i == 3:
                    raise SourceError("3.png: no picture that can be read")
                yield capture

    captures = list(recording(6).captures())
    source = Breaking(CAMERA, captures, [(c.t_source_ns, camera_at(2, 0)) for c in captures])
    with pytest.raises(SourceError, match="3.png"):
        flown(tmp_path, source)
    assert [f["sequence"] for f in lines(tmp_path)] == [0, 1, 2]


def test_waiting_for_a_worker_ends_as_soon_as_there_is_one():
    """Its name is given; the link is asked again and again."""
    answers = iter([(), (), ("w7",)])
    link = MemoryLink(CLOCK, answering())
    link.workers = lambda: next(answers)
    assert wait_for_worker(link, patient(wait_for_worker_s=600)) == ("w7",)


def test_settings_reach_the_parts_in_nanoseconds_and_each_start_is_another():
    """One statement of each bound; the boot id is random."""
    settings = ClientSettings(tau_max_ms=123.5, age_max_ms=200, control_hz=100, window=3)
    a, b = flight_settings(settings), flight_settings(settings)
    assert (a.gate.tau_max_ns, a.gate.age_max_ns) == (123_500_000, 200 * MS)
    assert (a.uplink.window, a.uplink.age_max_ns) == (3, 200 * MS)
    assert a.rate.serialisation_max_ns == 41_166_666
    assert a.control.filter.period_s == 0.01
    assert a.control.filter.age_max_ns == 200 * MS
    assert a.uplink.boot_id != b.uplink.boot_id


def test_own_eyes_are_set_up_only_where_they_are_asked_for():
    """Their target is loaded, their time is in nanoseconds, the filter's growth in metres."""
    assert flight_settings(ClientSettings()).own_eyes is None
    asked = ClientSettings(
        onboard_fallback=True,
        onboard_target="bullseye-200",
        onboard_max_s=2.5,
        onboard_growth_mm_s=25,
    )
    parts = flight_settings(asked)
    assert parts.own_eyes.target.name == "bullseye-200"
    assert parts.own_eyes.alone_max_ns == 2_500 * MS
    assert parts.control.filter.unconfirmed_mps == 0.025


def test_the_odometrys_budget_reaches_what_is_believed_of_the_target(tmp_path):
    """A mounting that is known ten times worse makes the estimate as much worse."""
    budget = OdometryBudget(sigma_m=0.02)
    parts = replace(flight_settings(patient()), odometry=OdometrySettings(budget))
    sigmas_m = []
    for i, given in enumerate((None, parts)):
        with Rig(tmp_path / str(i), answering(sees), parts=given) as rig:
            rig.capture()
            assert eventually(lambda rig=rig: rig.flight.receiver.estimate is not None)
            estimate = rig.flight.receiver.estimate
            sigmas_m.append(estimate.sigma_m)
    assert estimate.budget == budget
    usual, worse = (s**2 for s in sigmas_m)
    np.testing.assert_allclose(worse - usual, 0.02**2 - 0.001**2, rtol=0.02)


def test_a_result_makes_the_drone_close_in_and_stopping_makes_it_stand_still(tmp_path):
    """Commands go east, towards the target; the last one of all is zero."""
    body = pose((3, 1, 1.45))
    with Rig(tmp_path, answering(sees), world_from_body=lambda now_ns: body) as rig:
        rig.capture()
        commands = rig.autopilot.commands
        assert eventually(lambda: bool(commands) and commands[-1].velocity_world[0] > 0.05)
    assert not rig.autopilot.commands[-1].velocity_world.any()
    assert rig.flight.tally.outcomes == {"target": 1}
    assert rig.flight.tally.control_errors == 0
    assert {"inactive", "active"} & set(rig.flight.tally.statuses)


def test_what_goes_wrong_with_one_message_does_not_end_the_link_s_thread(tmp_path, caplog):
    """A consumer of poses that raises: counted, logged once, and results go on being used."""

    def broken(reception: object) -> None:
        raise RuntimeError("no such topic")

    link = MemoryLink(CLOCK, answering(sees))
    source = recording(4)
    summary = replay(
        source,
        AIRFRAME,
        patient(),
        ReplayOptions(tmp_path, plot=False),
        link,
        CLOCK,
        lambda done, tally: None,
        broken,
    )
    assert summary["receive_errors"] == 4
    assert summary["fates"] == {"answered": 4}
    assert len([r for r in caplog.records if "could not be handled" in r.message]) == 1


class FailingAutopilot(MemoryAutopilot):
    """Raises on its first calls."""

    def __init__(self, failures: int) -> None:
        super().__init__()
        self.failures = failures

    def command(self, command: VelocityCommand) -> None:
        if self.failures > 0:
            self.failures -= 1
            raise ConnectionError("serial port gone")
        super().command(command)


def test_an_autopilot_that_raises_is_counted_logged_once_and_asked_again(tmp_path, caplog):
    """The control loop outlives it; as soon as it takes commands again it gets them."""
    caplog.set_level(logging.ERROR)
    with Rig(tmp_path, autopilot=FailingAutopilot(7)) as rig:
        assert eventually(lambda: len(rig.autopilot.commands) > 3)
    assert rig.flight.tally.control_errors == 7
    assert not rig.autopilot.commands[-1].velocity_world.any()
    assert len(caplog.records) == 1
    assert "serial port gone" in caplog.text


def test_an_autopilot_that_is_gone_for_good_does_not_hold_up_the_run(tmp_path, caplog):
    """Frames are still given up in time, and the flight ends."""
    gone = FailingAutopilot(10**9)
    with Rig(tmp_path, autopilot=gone, reply_timeout_ms=1, control_hz=500) as rig:
        rig.capture()
        rig.flight.drain()
        assert rig.ledger.fates == {Fate.NO_REPLY: 1}
    assert rig.flight.tally.control_errors > 0
    assert len(caplog.records) == 1


def test_a_tick_that_fails_commands_a_stop(tmp_path, caplog):
    """Odometry that raises: counted, and the drone stands still."""

    def lost(now_ns: int) -> Pose:
        raise RuntimeError("odometry lost")

    with Rig(tmp_path, world_from_body=lost) as rig:
        assert eventually(lambda: len(rig.autopilot.commands) > 5)
    assert rig.flight.tally.control_errors >= 5
    assert not any(c.velocity_world.any() for c in rig.autopilot.commands)
    assert "odometry lost" in caplog.text


def test_a_frame_that_nobody_answers_is_given_up_and_its_late_result_is_counted(tmp_path):
    """One line in the ledger, NO_REPLY; the result that comes after it is an event."""
    with Rig(tmp_path, reply_timeout_ms=1, control_hz=500) as rig:
        header = rig.capture()
        rig.flight.drain()
        rig.deliver(seal_ack(ack_of(header, "memory")))
        rig.deliver(seal_result(result_of(header, "memory", sees(header))))
        assert rig.flight.tally.late_results == 1
    (line,) = lines(tmp_path)
    assert (line["fate"], line["worker"]) == ("no_reply", "memory")
    assert line["known"] in ("no_target", "no_pose")
    assert [e["event"] for e in lines(tmp_path, EVENTS_NAME)][-1] == "late_result"


def test_a_made_up_result_is_an_event_and_leaves_the_frame_open(tmp_path):
    """The true answer still gets the frame's line."""
    with Rig(tmp_path) as rig:
        header = rig.capture()
        result = result_of(header, "memory", None)
        rig.deliver(seal_result(msgspec.structs.replace(result, t1_ns=1)))
        assert rig.ledger.under_way == 1
        rig.deliver(seal_ack(ack_of(header, "memory")))
        rig.deliver(seal_result(result))
        assert rig.ledger.under_way == 0
    (line,) = lines(tmp_path)
    assert (line["fate"], line["verdict"], line["reason"]) == ("answered", "accepted", "no box")
    refused = [e for e in lines(tmp_path, EVENTS_NAME) if e["event"] == "refused_result"]
    assert [(e["verdict"], e["sequence"]) for e in refused] == [("echo_mismatch", 0)]
    assert rig.flight.tally.verdicts == {"echo_mismatch": 1, "accepted": 1}


def test_what_could_not_be_written_at_the_end_is_told_and_costs_nothing_else(tmp_path):
    """A summary that has no place on the disk is still returned, and names file and fault."""
    (tmp_path / SUMMARY_NAME).mkdir()
    summary = flown(tmp_path, recording(4))
    assert summary["accepted_poses"] == 4
    assert summary["unwritten"] == [f"{tmp_path / SUMMARY_NAME}: Is a directory"]
    assert len(lines(tmp_path)) == 4
