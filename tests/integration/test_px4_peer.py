"""The MAVLink side against an independent PX4-like process, over real sockets and a pty."""

from __future__ import annotations

import os
import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.choose import open_autopilot
from drone_client.autopilot.px4 import PX4
from drone_client.autopilot.settings import AutopilotSettings
from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.geometry import Pose, quaternion_from_rotation, rotation_from_vector
from tests.integration.px4_process import Commander, PeerProcess, engaged, mode, until
from tests.service_process import free_udp_port


class Pair:
    """Our autopilot and the peer that it speaks with."""

    def __init__(self, *options: str) -> None:
        self.port = free_udp_port()
        self.options = ("--udp", f"127.0.0.1:{self.port}", *options)
        self.peer = PeerProcess(*self.options)
        self.autopilot = open_autopilot(f"udp/127.0.0.1:{self.port}", MonotonicClock())
        self.commander = Commander(self.autopilot)

    def take_off(self) -> None:
        """Engaged, with commands that stand still."""
        until(lambda: mode(self.autopilot), "a heartbeat")
        self.autopilot.engage()
        self.commander.fly((0.0, 0.0, 0.0), lambda: engaged(self.autopilot))

    def close(self) -> None:
        self.autopilot.close()
        self.peer.close()


@pytest.fixture
def pair() -> Iterator[Pair]:
    both = Pair()
    yield both
    both.close()


def test_nothing_is_sent_but_heartbeats_until_a_person_engages(pair: Pair) -> None:
    """Commands alone bring no setpoint and no question for a mode onto the line."""
    until(lambda: mode(pair.autopilot), "a heartbeat")
    pair.commander.fly((0.5, 0.0, 0.0), lambda: len(pair.peer.report()["heartbeats"]) >= 2)
    report = pair.peer.report()
    assert report["setpoints"] == 0
    assert report["set_mode_requests"] == []
    assert report["mode"] == "POSCTL"
    assert report["violations"] == []
    gaps = np.diff(report["heartbeats"])
    assert (np.abs(gaps - 1.0) < 0.3).all()


def test_offboard_is_entered_flown_and_left_in_order(pair: Pair) -> None:
    """Zero setpoints first, then the mode, then the commands; on release zero, then HOLD."""
    pair.take_off()
    # East and up, turning left: north-east-down turns it around
    pair.commander.fly(
        (0.4, 0.0, 0.2), lambda: pair.peer.report()["position_ned"][1] > 0.2, yaw_rate=0.5
    )
    flown = pair.peer.report()
    assert flown["violations"] == []
    assert flown.get("moving_outside", 0) == 0
    assert flown["rate_hz"] >= 30
    assert flown["position_ned"][2] < -1.55
    assert abs(flown["position_ned"][0]) < 1e-6
    assert flown["yaw_ned"] < 0.3
    first = flown["timeline"][0][-1]
    assert flown["set_mode_requests"][0][0] - first >= 1.0
    assert [r[1:] for r in flown["set_mode_requests"]] == [["OFFBOARD", 0]]

    pair.autopilot.release()
    pair.commander.fly((0.4, 0.0, 0.0), lambda: pair.autopilot.phase == "silent")
    left = pair.peer.report()
    assert left["mode"] == "AUTO.LOITER"
    assert not left["failsafe"]
    assert [r[1:] for r in left["set_mode_requests"]] == [["OFFBOARD", 0], ["AUTO.LOITER", 0]]
    asked = left["set_mode_requests"][1][0]
    before_hold = [row for row in left["timeline"] if row[-1] <= asked][-1]
    assert before_hold[2:6] == [0.0, 0.0, 0.0, 0.0]
    silent = left["setpoints"]
    pair.commander.fly(
        (0.4, 0.0, 0.0), lambda: len(pair.peer.report()["heartbeats"]) > len(left["heartbeats"])
    )
    assert pair.peer.report()["setpoints"] <= silent + 1
    assert left["violations"] == []


def test_an_interrupt_while_it_closes_comes_after_the_vehicle(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C again and again: HOLD is asked for and taken, and only then it is felt."""
    pair.take_off()
    wait, interrupts = pair.autopilot._silent.wait, iter(range(3))

    def interrupted(timeout_s: float) -> bool:
        for _ in interrupts:
            raise KeyboardInterrupt
        return wait(timeout_s)

    monkeypatch.setattr(pair.autopilot._silent, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pair.autopilot.close()
    report = pair.peer.report()
    assert (report["mode"], report["failsafe"]) == ("AUTO.LOITER", False)


def test_a_refusal_is_asked_again_and_a_lost_answer_does_no_harm() -> None:
    """Two refusals and a lost COMMAND_ACK later the vehicle is ours; the questions are few."""
    pair = Pair("--refuse", "2", "--lose-acks", "4")
    try:
        pair.take_off()
        report = pair.peer.report()
        assert report["mode"] == "OFFBOARD"
        assert [r[2] for r in report["set_mode_requests"][:3]] == [1, 1, 0]
        assert len(report["set_mode_requests"]) <= 6
        assert report["violations"] == []
    finally:
        pair.close()


def test_lost_questions_for_rates_are_asked_again() -> None:
    """A pose that comes by itself is not enough: every message has its rate in the end."""
    pair = Pair("--lose-rates", "7")
    try:
        asked = {str(number) for number in PX4.rates_hz}
        until(lambda: set(pair.peer.report()["intervals"]) == asked, "all rates are set")
    finally:
        pair.close()


def test_a_steady_refusal_ends_in_silence_with_a_reason() -> None:
    """After a bounded number of questions nothing is sent any more, and the reason is told."""
    pair = Pair("--refuse", "1000")
    try:
        until(lambda: mode(pair.autopilot), "a heartbeat")
        pair.autopilot.engage()
        until(lambda: pair.autopilot.phase != "silent", "the order begins")
        until(lambda: pair.autopilot.phase == "silent", "giving up")
        assert "refused 6 times" in pair.autopilot.reason
        report = pair.peer.report()
        assert len(report["set_mode_requests"]) == 6
        assert report["mode"] == "POSCTL"
    finally:
        pair.close()


def test_when_the_control_loop_stops_zero_then_silence_then_the_failsafe(pair: Pair) -> None:
    """The last command is flown for 60 ms, zero to 300 ms, and then PX4's own failsafe acts."""
    pair.take_off()
    pair.commander.fly((0.3, 0.0, 0.0), lambda: pair.peer.report()["position_ned"][1] > 0.1)
    last_ms = pair.commander.once((0.3, 0.0, 0.0)) // 1_000_000
    until(lambda: pair.peer.report()["failsafe"], "the peer's failsafe")
    report = pair.peer.report()
    assert report["mode"] == "AUTO.LOITER"
    # By the stamp that our pacer gave each setpoint: what this machine's load cannot move
    ages_ms = [(row[0] - last_ms, any(row[2:6])) for row in report["timeline"] if row[0] > last_ms]
    assert max((age for age, moving in ages_ms if moving), default=0) <= 61
    still = [age for age, moving in ages_ms if not moving]
    assert still, "zero velocity comes between the command and the silence"
    assert min(still) >= 60
    assert max(still) <= 301
    # Nobody asks again by himself, though commands flow again
    requests = len(report["set_mode_requests"])
    until(lambda: pair.autopilot.phase == "silent", "the engagement is over")
    assert pair.autopilot.reason == "no setpoint left for too long"
    seen = len(report["heartbeats"])
    pair.commander.fly((0.3, 0.0, 0.0), lambda: len(pair.peer.report()["heartbeats"]) >= seen + 2)
    after = pair.peer.report()
    assert len(after["set_mode_requests"]) == requests
    assert after["mode"] == "AUTO.LOITER"
    assert after["violations"] == []


def test_a_stopped_process_is_silence_and_its_waking_sends_no_burst(tmp_path: Path) -> None:
    """SIGSTOP: the peer's failsafe acts. SIGCONT: no burst, no question, no moving setpoint."""
    port = free_udp_port()
    peer = PeerProcess("--udp", f"127.0.0.1:{port}")
    script = Path(__file__).with_name("px4_commander.py")
    ours = subprocess.Popen([sys.executable, str(script), f"udp/127.0.0.1:{port}"])
    try:
        until(lambda: peer.report()["position_ned"][1] > 0.1, "flying east")
        ours.send_signal(signal.SIGSTOP)
        until(lambda: peer.report()["failsafe"], "the peer's failsafe")
        stopped = peer.report()
        assert stopped["mode"] == "AUTO.LOITER"
        seen = len(stopped["heartbeats"])
        ours.send_signal(signal.SIGCONT)
        until(lambda: len(peer.report()["heartbeats"]) >= seen + 2, "two heartbeats more")
        woken = peer.report()
        assert woken["mode"] == "AUTO.LOITER"
        assert len(woken["set_mode_requests"]) == 1
        # Its engagement ended with the pause; one may have been on its way into the socket
        assert woken["setpoints"] <= stopped["setpoints"] + 1
        assert woken["violations"] == []
    finally:
        ours.kill()
        ours.wait()
        peer.close()


def test_a_pilots_switch_is_obeyed_and_never_fought(pair: Pair) -> None:
    """After the pilot's switch nothing is sent until a person engages again."""
    pair.take_off()
    pair.commander.fly((0.2, 0.0, 0.0), lambda: pair.peer.report()["moving_setpoints"] > 10)
    pair.peer.tell("mode POSCTL")
    pair.commander.fly((0.2, 0.0, 0.0), lambda: pair.autopilot.phase == "silent")
    report = pair.peer.report()
    assert "POSCTL" in pair.autopilot.reason
    silent, seen = report["setpoints"], len(report["heartbeats"])
    pair.commander.fly((0.2, 0.0, 0.0), lambda: len(pair.peer.report()["heartbeats"]) >= seen + 2)
    report = pair.peer.report()
    assert report["setpoints"] <= silent + 1
    assert report["mode"] == "POSCTL"
    assert len(report["set_mode_requests"]) == 1
    pair.take_off()
    assert pair.peer.report()["mode"] == "OFFBOARD"
    assert pair.peer.report()["violations"] == []


def test_a_killed_peer_grows_old_and_one_that_comes_back_is_a_new_clock(pair: Pair) -> None:
    """Its last heartbeat stays the last; the restarted one is heard, and its clock learnt anew."""
    pair.take_off()
    pair.peer.kill()
    pair.commander.fly((0.1, 0.0, 0.0), lambda: pair.autopilot.phase == "silent")
    assert "heartbeat" in pair.autopilot.reason
    state = pair.autopilot.state()
    assert state is not None
    assert time.monotonic_ns() - state.t_heard_ns > 2_000_000_000
    pair.peer = PeerProcess(*pair.options, "--boot-age", "5")
    heard_ns = state.t_heard_ns
    until(lambda: pair.autopilot.state().t_heard_ns > heard_ns, "the new one is heard")
    truth_ns = pair.peer.report()["clock_offset_s"] * 1e9
    until(lambda: abs(pair.autopilot.clock_offset_ns()[0] - truth_ns) < 5e6, "the new clock")
    pose_ns = pair.autopilot.state().t_pose_ns
    until(lambda: pair.autopilot.state().t_pose_ns > pose_ns, "poses on our clock again")
    assert mode(pair.autopilot) == "POSCTL"
    assert pair.peer.report()["mode"] == "POSCTL"


def test_clocks_and_poses_agree_both_ways(pair: Pair) -> None:
    """The offset is the true one, poses carry our time, and our ODOMETRY is of its time there."""
    until(lambda: pair.autopilot.state() and pair.autopilot.state().t_pose_ns, "a pose")
    until(lambda: pair.peer.report()["timesync_good"] > 10, "their TIMESYNC")
    truth_ns = pair.peer.report()["clock_offset_s"] * 1e9
    offset_ns, bound_ns = pair.autopilot.clock_offset_ns()
    assert abs(offset_ns - truth_ns) <= bound_ns + 1e5
    assert bound_ns < 20e6
    state = pair.autopilot.state()
    assert abs(time.monotonic_ns() - state.t_pose_ns) < 0.5e9
    # NED (0, 0, -1.5), heading 0.3 from north clockwise: ENU up 1.5, from east pi/2 - 0.3
    assert np.allclose(state.world_from_body.translation, [0, 0, 1.5])
    forward = state.world_from_body.rotation[:, 0]
    assert np.arctan2(forward[1], forward[0]) == pytest.approx(np.pi / 2 - 0.3, abs=1e-6)
    assert state.battery_fraction == pytest.approx(0.87)
    assert state.landed is False
    assert state.armed
    assert state.failsafe == ""
    assert pair.autopilot.odometry().resets == 7
    assert pair.autopilot.odometry().covariance[1, 1] == pytest.approx(1e-4)  # north is y here

    # What the robot gives: stamped with an exposure 40 ms ago
    q = quaternion_from_rotation(rotation_from_vector(np.array([0.0, 0.0, 0.5])))
    covariance = np.diag([1e-4, 4e-4, 9e-4, 1e-5, 2e-5, 3e-5])
    for i in range(20):
        t_ns = time.monotonic_ns() - 40_000_000
        pose = Pose(np.array([1.0, 2.0, 3.0]), q)
        pair.autopilot.give_odometry(
            OdometrySample(t_ns, pose, np.array([0.1, 0.0, 0.0]), covariance, resets=256 + i // 10)
        )
        pair.autopilot.give_range(RangeSample(t_ns, 1.234))
        until(lambda n=i: len(pair.peer.report()["ranges"]) > n, "the range arrives")
    pair.autopilot.give_range(RangeSample(time.monotonic_ns(), 99.0, looks_down=False))
    until(lambda: len(pair.peer.report()["ranges"]) == 21, "the last range")
    report = pair.peer.report()
    assert len(report["odometry"]) == 20
    last = report["odometry"][-1]
    assert last["p"] == pytest.approx([2.0, 1.0, -3.0])
    assert last["q"] == pytest.approx(_enu_to_ned_heading(0.5), abs=1e-6)
    # 0.1 m/s east, seen from a body that looks 0.5 rad left of east: forward and to the right
    assert last["v"] == pytest.approx([0.1 * np.cos(0.5), 0.1 * np.sin(0.5), 0.0], abs=1e-6)
    assert last["variance"] == pytest.approx([4e-4, 1e-4, 9e-4, 2e-5, 1e-5, 3e-5], rel=1e-5)
    assert [o["resets"] for o in report["odometry"]] == [0] * 10 + [1] * 10
    assert last["quality"] == 100
    # The quickest is the one that waited for no loop: its age is the 40 ms that it was given
    assert min(o["age_s"] for o in report["odometry"]) == pytest.approx(0.040, abs=0.010)
    assert report["ranges"][0] == [123, 10, 1200, 25, 100]
    assert report["ranges"][-1] == [9900, 10, 1200, 0, 1]
    assert report["violations"] == []


def _enu_to_ned_heading(yaw_enu: float) -> list[float]:
    yaw_ned = np.pi / 2 - yaw_enu
    q = [np.cos(yaw_ned / 2), 0.0, 0.0, np.sin(yaw_ned / 2)]
    return [float(c) for c in q]


def test_failsafe_battery_and_landing_are_told(pair: Pair) -> None:
    """What the autopilot says of itself comes out in words and numbers."""
    until(lambda: mode(pair.autopilot), "a heartbeat")
    pair.peer.tell("battery 9")
    until(lambda: pair.autopilot.state().failsafe == "battery critical", "the battery")
    assert pair.autopilot.state().battery_fraction == pytest.approx(0.09)
    pair.peer.tell("disarm")
    until(lambda: pair.autopilot.state().landed, "the landing")
    until(lambda: not pair.autopilot.state().armed, "disarmed")
    assert not pair.autopilot.state().obeying


def test_disarming_ends_the_engagement(pair: Pair) -> None:
    """A vehicle that was disarmed under us does not fly our commands when it is armed again."""
    pair.take_off()
    pair.peer.tell("disarm")
    pair.commander.fly((0.2, 0.0, 0.0), lambda: pair.autopilot.phase == "silent")
    assert pair.autopilot.reason == "disarmed"


def test_garbage_strangers_and_floods_do_no_harm(pair: Pair) -> None:
    """Noise from the peer's own address and from strangers: counted, and the flight goes on."""
    pair.take_off()
    noise = random.Random(5)
    sent = 0
    with socket.socket(type=socket.SOCK_DGRAM) as stranger:
        stranger.connect(("127.0.0.1", pair.port))
        while sent < 3000:
            data = noise.randbytes(noise.randrange(1, 300))
            if sent % 3 == 0:
                data = bytes([0xFD]) + data
            stranger.send(data)
            sent += 1
            if sent % 50 == 0:
                pair.commander.once((0.1, 0.0, 0.0))
                time.sleep(0.005)
    before = pair.peer.report()["moving_setpoints"]
    pair.commander.fly((0.1, 0.0, 0.0), lambda: pair.peer.report()["moving_setpoints"] > before + 5)
    assert engaged(pair.autopilot)
    counts = pair.autopilot.counts()
    assert counts["refused_stranger"] > 0
    assert counts["errors"] == 0
    assert pair.peer.report()["violations"] == []


def test_a_command_that_cannot_be_flown_counts_as_none(pair: Pair) -> None:
    """NaN and commands over the limit do not reach the line; the dead man acts instead."""
    pair.take_off()
    clock = MonotonicClock()
    bad = [(np.nan, 0.0, 0.0), (np.inf, 0.0, 0.0), (5.0, 0.0, 0.0)]
    end = threading.Event()
    until(lambda: pair.peer.report()["rate_hz"] >= 10, "a rate")
    while not pair.peer.report()["failsafe"]:
        for velocity in bad:
            pair.autopilot.command(VelocityCommand(np.array(velocity), 0.0, clock.now_ns()))
        pair.autopilot.command(VelocityCommand(np.zeros(3), float("nan"), clock.now_ns()))
        end.wait(0.01)
    report = pair.peer.report()
    assert report["moving_setpoints"] == 0
    assert report["violations"] == []
    counts = pair.autopilot.counts()
    assert counts["refused_command_not_finite"] > 0
    assert counts["refused_command_too_fast"] > 0


def test_parameters_are_read_and_missing_ones_are_missing(pair: Pair) -> None:
    """Whole numbers come through MAVLink's float unharmed; names that nobody has are left out."""
    until(lambda: mode(pair.autopilot), "a heartbeat")
    names = ["EKF2_EV_CTRL", "COM_OF_LOSS_T", "EKF2_HGT_REF"]
    values = pair.autopilot.read_parameters(names, 20.0)
    assert values == {"EKF2_EV_CTRL": 9, "COM_OF_LOSS_T": 0.5, "EKF2_HGT_REF": 1}
    assert pair.autopilot.read_parameters(["NO_SUCH_PARAM", "x" * 40], 0.5) == {}


def test_the_other_system_is_not_listened_to() -> None:
    """Settings that name system 7 hear nothing of system 1."""
    port = free_udp_port()
    peer = PeerProcess("--udp", f"127.0.0.1:{port}")
    autopilot = open_autopilot(
        f"udp/127.0.0.1:{port}", MonotonicClock(), AutopilotSettings(system=7)
    )
    try:
        until(lambda: autopilot.counts().get("refused_other_system", 0) > 10, "messages of 1")
        assert autopilot.state() is None
        assert peer.report()["setpoints"] == 0
    finally:
        autopilot.close()
        peer.close()


def test_a_serial_line_carries_all_of_it() -> None:
    """Over a pty: engaged, flown, released; garbage on the wire in between."""
    ours, theirs = os.openpty()
    wire, other = os.openpty()
    # Two ptys back to back make a wire with a device name at each end
    names = os.ttyname(theirs), os.ttyname(other)
    stop = threading.Event()
    bridge = threading.Thread(target=_bridge, args=(ours, wire, stop), daemon=True)
    bridge.start()
    peer = PeerProcess("--serial", names[1])
    autopilot = open_autopilot(f"serial/{names[0]}:921600", MonotonicClock())
    commander = Commander(autopilot)
    try:
        until(lambda: mode(autopilot), "a heartbeat")
        autopilot.engage()
        commander.fly((0.0, 0.0, 0.0), lambda: engaged(autopilot))
        os.write(ours, random.Random(1).randbytes(500))
        commander.fly((0.3, 0.0, 0.0), lambda: peer.report()["position_ned"][1] > 0.1)
        assert peer.report()["violations"] == []
        autopilot.release()
        until(lambda: autopilot.phase == "silent", "released")
        assert peer.report()["mode"] == "AUTO.LOITER"
        counts = autopilot.counts()
        assert counts["refused_garbage"] > 0
        assert counts["errors"] == 0
    finally:
        autopilot.close()
        peer.close()
        stop.set()
        bridge.join()
        for fd in (ours, theirs, wire, other):
            os.close(fd)


def _bridge(a: int, b: int, stop: threading.Event) -> None:
    while not stop.is_set():
        for fd in select.select([a, b], [], [], 0.05)[0]:
            os.write(b if fd == a else a, os.read(fd, 4096))


def test_the_example_flies_its_square() -> None:
    """The first flight of a new link, against the peer: four sides, and back in a hold."""
    example = Path(__file__).parents[2] / "examples" / "px4" / "velocity_square.py"
    port = free_udp_port()
    peer = PeerProcess("--udp", f"127.0.0.1:{port}")
    try:
        run = subprocess.run(
            [sys.executable, example, f"udp/127.0.0.1:{port}", "--yes", "--side-s", "0.5"],
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert run.returncode == 0, run.stderr
        assert run.stdout.count("moved") == 4
        assert "released: AUTO.LOITER" in run.stdout
        report = peer.report()
        assert report["violations"] == []
        assert report["moving_setpoints"] > 40
        assert len(example.read_text().splitlines()) <= 80
    finally:
        peer.close()
