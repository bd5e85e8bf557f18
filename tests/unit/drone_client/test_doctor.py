"""The doctor's judgements: every fact that should worry a pilot does, and says what to change."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from drone_client.airframe import Airframe
from drone_client.autopilot.ardupilot import ARDUPILOT
from drone_client.autopilot.parameters import packaged_parameters
from drone_client.autopilot.simulated import SimulatedAutopilot
from drone_client.cli import app
from drone_client.doctor.camera import CameraFacts, judge_camera_run
from drone_client.doctor.files import check_files, judge_airframe, judge_camera
from drone_client.doctor.finding import Check, Finding
from drone_client.doctor.machine import MachineFacts, collect_machine, judge_machine
from drone_client.doctor.odometry import OdometryFacts, StreamFacts, judge_odometry
from drone_client.doctor.path import PathFacts, collect_path, judge_path
from drone_client.doctor.service import ServiceFacts, WorkerFacts, judge_service
from drone_client.doctor.vehicle import VehicleFacts, judge_vehicle
from drone_client.odometry import OdometrySample
from drone_client.odometry.jump import Jump, JumpReason
from drone_client.settings import ClientSettings
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Status
from target_pose.target import Target, load_target
from tests.certificates import make_ending, make_ends
from tests.unit.drone_client.builders import pose

MACHINE = MachineFacts(60, 5.0, 10**10, 4, ("performance",), True, 4_000_000, 4_000_000)
STATE = replace(
    SimulatedAutopilot(MonotonicClock(), pose((0, 0, 1))).state(), armed=False, landed=True
)
WANTED = {name: p.value for name, p in packaged_parameters().items()}


def estimate(yaw_rad: float) -> OdometrySample:
    """The autopilot's own, with that doubt about its heading."""
    return OdometrySample(0, pose(), np.zeros(3), np.diag([1e-4] * 5 + [yaw_rad**2]))


VEHICLE = VehicleFacts(STATE, 50.0, 20.0, estimate(0.03), 0, 0.2, WANTED, 1.0, 1.1)
ODOMETRY = OdometryFacts(
    True,
    {
        "odometry": StreamFacts(200.0, 20.0),
        "height": StreamFacts(50.0, 20.0, 0.0, 1.1),
        "ahead": StreamFacts(50.0, 20.0, 0.0, 2.5),
    },
)
COUNTS = {"color_frames": 90, "depth_frames": 90, "paired": 89, "color_no_partner": 1}
CAMERA = CameraFacts("", 30.0, 30.0, 1.0, 0.2, 120.0, COUNTS)
STATUS = Status("w1", 1, 1, 0, 1, 8, 30_000_000, 50_000_000, "a" * 64, False)
WORKER = WorkerFacts("w1", 40, tuple([5.0] * 40), STATUS)
SETTINGS = ClientSettings()


def of(checks: list[Check], name: str) -> Check:
    (found,) = [check for check in checks if check.name == name]
    return found


def worst(checks) -> set[Finding]:
    return {c.finding for c in checks} - {Finding.OK, Finding.UNCHECKED}


def test_a_healthy_drone_gets_nothing_but_ok():
    """No advice where nothing has to be changed."""
    two = ServiceFacts((WORKER, replace(WORKER, name="w2")), http={"/livez": "ok"})
    checks = [
        *judge_machine(MACHINE, True),
        *judge_vehicle(VEHICLE, "udp/x:1"),
        *judge_odometry(ODOMETRY, "tcp/x:1"),
        *judge_service(two, SETTINGS),
        *judge_camera_run(CAMERA),
        judge_airframe(Airframe()),
    ]
    assert worst(checks) == set(), [c for c in checks if c.finding in worst(checks)]
    assert not any(c.advice for c in checks)


@pytest.mark.parametrize(
    ("changes", "name", "finding"),
    [
        ({"clock_step_ns": 10_000_000}, "clock", Finding.FAULT),
        ({"cores": 1}, "cores", Finding.WARNING),
        ({"first_in_line": False}, "priority", Finding.WARNING),
        ({"governors": ("powersave",)}, "cpu frequency", Finding.WARNING),
        ({"free_bytes": 10**7}, "disk", Finding.FAULT),
        ({"free_bytes": None}, "disk", Finding.FAULT),
        ({"write_ms": 251.0}, "disk speed", Finding.WARNING),
        ({"rmem_max": 212_992}, "socket buffers", Finding.WARNING),
        ({"rmem_max": None}, "socket buffers", Finding.UNCHECKED),
    ],
)
def test_the_machine(changes: dict, name: str, finding: Finding):
    """Each shortcoming by itself, with advice."""
    check = of(list(judge_machine(replace(MACHINE, **changes), True)), name)
    assert check.finding is finding
    assert bool(check.advice) is (finding is not Finding.UNCHECKED)


def test_small_buffers_matter_to_the_tunnel_alone():
    """Zenoh over TCP has its own."""
    small = replace(MACHINE, rmem_max=212_992)
    assert of(list(judge_machine(small, False)), "socket buffers").finding is Finding.OK


@pytest.mark.parametrize(
    ("changes", "name", "finding"),
    [
        ({"state": None}, "heartbeat", Finding.FAULT),
        ({"state": replace(STATE, world_from_body=None)}, "pose", Finding.FAULT),
        ({"pose_hz": 20.0}, "pose rate", Finding.WARNING),
        ({"pose_hz": 4.0}, "pose rate", Finding.FAULT),
        ({"pose_age_ms": 300.0}, "pose age", Finding.WARNING),
        ({"resets": 2}, "estimate", Finding.FAULT),
        ({"clock_bound_ms": None}, "time sync", Finding.WARNING),
        ({"clock_bound_ms": 9.0}, "time sync", Finding.WARNING),
        ({"state": replace(STATE, battery_fraction=0.3)}, "battery", Finding.WARNING),
        ({"state": replace(STATE, battery_fraction=0.1)}, "battery", Finding.FAULT),
        ({"state": replace(STATE, battery_fraction=None)}, "battery", Finding.UNCHECKED),
        ({"state": replace(STATE, failsafe="rc lost")}, "failsafe", Finding.FAULT),
        ({"parameters": WANTED | {"EKF2_HGT_REF": 1}}, "EKF2_HGT_REF", Finding.FAULT),
        ({"parameters": WANTED | {"EKF2_HGT_REF": 1}}, "parameters", Finding.FAULT),
        ({"parameters": {}}, "parameters", Finding.WARNING),
        ({"parameters": {"EKF2_HGT_REF": 2}}, "parameters", Finding.WARNING),
        ({"state": replace(STATE, armed=True)}, "arming", Finding.WARNING),
        ({"state": replace(STATE, armed=True, landed=True)}, "arming", Finding.WARNING),
        ({"odometry": None}, "heading", Finding.UNCHECKED),
        ({"odometry": estimate(0.0)}, "heading", Finding.UNCHECKED),
        ({"odometry": estimate(np.inf)}, "heading", Finding.UNCHECKED),
        ({"odometry": estimate(0.2)}, "heading", Finding.WARNING),
        ({"odometry": estimate(1.0)}, "heading", Finding.FAULT),
        ({"lidar_m": None}, "height", Finding.UNCHECKED),
        ({"lidar_m": 1.4}, "height", Finding.WARNING),
        ({"lidar_m": 2.1}, "height", Finding.FAULT),
        ({"parameters": None}, "parameters", Finding.UNCHECKED),
        (
            {"parameters": {"GUID_TIMEOUT": 3.0}, "parameter_file": ARDUPILOT.parameter_file},
            "GUID_TIMEOUT",
            Finding.FAULT,
        ),
        (
            {"parameters": {"GUID_TIMEOUT": 0.5}, "parameter_file": ARDUPILOT.parameter_file},
            "parameters",
            Finding.OK,
        ),
    ],
)
def test_the_vehicle(changes: dict, name: str, finding: Finding):
    """Each shortcoming by itself."""
    check = of(list(judge_vehicle(replace(VEHICLE, **changes), "udp/x:1")), name)
    assert check.finding is finding


def test_a_vehicle_that_gets_its_vio_from_us_has_no_place_yet():
    """Nobody is told to give it what is given already."""
    facts = replace(VEHICLE, state=replace(STATE, world_from_body=None))
    assert of(list(judge_vehicle(facts, "udp/x:1")), "pose").finding is Finding.FAULT
    check = of(list(judge_vehicle(facts, "udp/x:1", feeds_vio=True)), "pose")
    assert check.finding is Finding.UNCHECKED
    assert "--vio-topic" in check.found


def test_an_airframe_that_leaves_out_the_propellers_is_warned_of():
    """They are flown as of another drone; what is worse is told first."""
    check = judge_airframe(replace(Airframe(), assumed=("part",)))
    assert check.finding is Finding.WARNING
    assert "part of the default drone" in check.found
    short = replace(Airframe(), assumed=("part",), body_from_tip=pose((0.2, 0, 0)))
    assert judge_airframe(short).finding is Finding.FAULT


def test_a_body_on_its_back_is_a_frame_that_is_wrong():
    """Its z points down: NED taken for ENU, or a board that is mounted otherwise."""
    over = replace(STATE, world_from_body=Pose(np.zeros(3), np.array([0.0, 1.0, 0.0, 0.0])))
    check = of(list(judge_vehicle(replace(VEHICLE, state=over), "udp/x:1")), "attitude")
    assert check.finding is Finding.FAULT
    assert "down" in check.found


def test_a_wrong_parameter_says_what_it_should_be_and_why():
    """With the packaged file's own reason."""
    wrong = replace(VEHICLE, parameters=WANTED | {"EKF2_HGT_REF": 1})
    check = of(list(judge_vehicle(wrong, "udp/x:1")), "EKF2_HGT_REF")
    assert check.advice.startswith("set it to 2: ")
    assert len(check.advice) > 20


def test_a_parameter_without_an_answer_is_not_told_to_be_well():
    """One row, which names it; what was answered otherwise is a fault of its own beside it."""
    some = {n: v for n, v in WANTED.items() if n != "NAV_RCL_ACT"} | {"EKF2_HGT_REF": 1}
    checks = list(judge_vehicle(replace(VEHICLE, parameters=some), "udp/x:1"))
    check = of(checks, "parameters")
    n = len(WANTED)
    assert check.found == f"{n - 2} of {n} as packaged, 1 otherwise, no answer for NAV_RCL_ACT"
    for left_out in range(1, n + 1):
        some = dict(list(WANTED.items())[left_out:])
        checks = list(judge_vehicle(replace(VEHICLE, parameters=some), "udp/x:1"))
        assert of(checks, "parameters").finding is Finding.WARNING
        assert of(checks, "parameters").found.startswith(f"{n - left_out} of {n} ")


@pytest.mark.parametrize(
    ("changes", "name", "finding"),
    [
        ({"connected": False}, "ROS 2", Finding.FAULT),
        ({"streams": {"odometry": StreamFacts()}}, "VIO rate", Finding.FAULT),
        ({"streams": {"odometry": StreamFacts(5.0, 9.0)}}, "VIO rate", Finding.FAULT),
        ({"streams": {"odometry": StreamFacts(20.0, 9.0)}}, "VIO rate", Finding.WARNING),
        ({"streams": {"odometry": StreamFacts(50.0, 200.0)}}, "VIO age", Finding.WARNING),
        (
            {"streams": {"height": StreamFacts(6.0, 9.0, 0.0, 1.0)}},
            "lidar down rate",
            Finding.WARNING,
        ),
        ({"streams": {"ahead": StreamFacts()}}, "lidar ahead rate", Finding.FAULT),
        (
            {"streams": {"height": StreamFacts(50.0, 9.0, 0.9, 0.05)}},
            "lidar down distance",
            Finding.WARNING,
        ),
        ({"jump": Jump(JumpReason.POSITION, 0, 0.3, 0.05), "jumps": 1}, "VIO jumps", Finding.FAULT),
        ({"refused": {"stamp": 40}}, "messages", Finding.FAULT),
        ({"refused": {"malformed": 1}}, "messages", Finding.FAULT),
    ],
)
def test_the_odometry(changes: dict, name: str, finding: Finding):
    """Each shortcoming of the robot's own sensors by itself, with advice."""
    check = of(list(judge_odometry(replace(ODOMETRY, **changes), "tcp/x:1")), name)
    assert check.finding is finding
    assert check.advice


def test_a_vio_that_is_silent_is_not_told_to_be_well():
    """It does not jump, and none of its messages is refused; nobody can tell."""
    checks = list(judge_odometry(OdometryFacts(True, {"odometry": StreamFacts()}), ""))
    assert [c.finding for c in checks] == [Finding.FAULT]


def test_a_topic_that_nobody_asked_for_is_no_row():
    """A robot without a lidar gets no line about one."""
    checks = judge_odometry(OdometryFacts(True, {"height": StreamFacts(50.0, 9.0, 0.0, 1.0)}), "")
    assert not [c for c in checks if "VIO" in c.name or "ahead" in c.name]


@pytest.mark.parametrize(
    ("changes", "name", "finding"),
    [
        ({"round_trips_ms": ()}, "way to w1", Finding.FAULT),
        ({"round_trips_ms": (400.0,) * 40}, "way to w1", Finding.FAULT),
        ({"round_trips_ms": (5.0,) * 20}, "way to w1", Finding.WARNING),
        ({"round_trips_ms": (5.0,) * 39 + (200.0,)}, "way to w1", Finding.WARNING),
        ({"status": None}, "worker w1", Finding.UNCHECKED),
        ({"status": Status("w1", 1, 1, 0, 8, 8, 0, 0, "", False)}, "worker w1", Finding.WARNING),
        ({"status": Status("w1", 1, 1, 0, 1, 8, 0, 0, "", True)}, "worker w1", Finding.WARNING),
    ],
)
def test_a_worker(changes: dict, name: str, finding: Finding):
    """Each shortcoming by itself."""
    facts = ServiceFacts((replace(WORKER, **changes), replace(WORKER, name="w2")))
    assert of(list(judge_service(facts, SETTINGS)), name).finding is finding


def test_the_service_as_a_whole():
    """None, one alone, another version, another model, a page that is not well."""
    none = list(judge_service(ServiceFacts(why="nobody there"), SETTINGS))
    assert (none[0].finding, none[0].advice) == (Finding.FAULT, "nobody there")
    alone = ServiceFacts((WORKER,), bad_messages=3, http={"/readyz": "no model"})
    checks = list(judge_service(alone, SETTINGS))
    assert of(checks, "workers").finding is Finding.WARNING
    assert of(checks, "protocol").finding is Finding.FAULT
    assert of(checks, "/readyz").finding is Finding.FAULT
    other = Status("w2", 1, 1, 0, 1, 8, 0, 0, "b" * 64, False)
    mixed = ServiceFacts((WORKER, replace(WORKER, name="w2", status=other)))
    assert of(list(judge_service(mixed, SETTINGS)), "models").finding is Finding.WARNING


def test_the_link_the_way_and_the_target():
    """Told also where no worker lives: they may be why."""
    own = load_target("bullseye-200")
    said = json.loads(msgspec.json.encode(load_target("bullseye-400")))
    bare = ServiceFacts(
        link_warnings=("TCP congestion control is 'cubic'",),
        paths=(
            PathFacts("udp/a:1", 1228),
            PathFacts("udp/b:1", 1227),
            PathFacts("udp/c:1", 1247, 48),
            PathFacts("udp/d:1", 1248, 48),
            PathFacts("udp/e:1", error="Network is unreachable"),
            PathFacts("udp/f:1"),
        ),
        target=said,
    )
    for facts in (bare, replace(bare, workers=(WORKER,))):
        checks = list(judge_service(facts, SETTINGS, own))
        found = [of(checks, f"path to udp/{place}:1").finding.value for place in "abcdef"]
        assert found == ["ok", "fault", "fault", "ok", "fault", "not checked"]
        assert of(checks, "link").finding is Finding.WARNING
        target = of(checks, "target")
        assert target.finding is Finding.FAULT
        assert "bullseye-400, the drone's own eyes for bullseye-200" in target.found


def test_the_target_is_the_same_by_name_and_by_its_sizes():
    """One name in two files of different sizes puts the board at two distances."""
    own = load_target("bullseye-400")
    said = json.loads(msgspec.json.encode(own))

    def target(said: dict, own: Target | None = own) -> Check:
        facts = ServiceFacts((WORKER,), target=said)
        return of(list(judge_service(facts, SETTINGS, own)), "target")

    assert target(said).finding is Finding.OK
    assert target(said, None).finding is Finding.OK
    assert target(said | {"colours": {}}).finding is Finding.OK
    larger = target(said | {"board_side_m": 0.41})
    assert larger.finding is Finding.FAULT
    assert "board_side_m" in larger.found
    assert target({}).finding is Finding.FAULT


def test_the_kernel_knows_the_way_or_says_why_not():
    """The loopback takes any datagram; a host that is none has no way."""
    assert collect_path("udp/127.0.0.1:9").mtu_bytes >= 1500
    for host in ("nowhere.invalid", "a..b"):
        nowhere = collect_path(f"udp/{host}:9")
        assert nowhere.error
        assert judge_path(nowhere).finding is Finding.FAULT


def counted(**more: int) -> CameraFacts:
    """A camera that is well, but for these counts."""
    return replace(CAMERA, counts=COUNTS | more)


@pytest.mark.parametrize(
    ("facts", "name", "finding"),
    [
        (CameraFacts("no camera"), "pictures", Finding.FAULT),
        (CameraFacts("", 3.0, 30.0, 1.0, 0.2, 120.0), "rate", Finding.FAULT),
        (CameraFacts("", 8.0, 30.0, 1.0, 0.2, 120.0), "rate", Finding.WARNING),
        (CameraFacts("", 30.0, 300.0, 1.0, 0.2, 120.0), "age", Finding.WARNING),
        (CameraFacts("", 30.0, 30.0, 1.0, 0.9, 120.0), "depth", Finding.WARNING),
        (CameraFacts("", 30.0, 30.0, 0.0, None, 120.0), "depth", Finding.WARNING),
        (CameraFacts("", 30.0, 30.0, 1.0, 0.2, 5.0), "light", Finding.WARNING),
        (counted(color_dropped=3), "drops", Finding.OK),
        (counted(color_dropped=2, depth_dropped=2), "drops", Finding.WARNING),
        (counted(depth_no_partner=20), "pairs", Finding.WARNING),
        (counted(depth_too_old=20), "pairs", Finding.WARNING),
        (counted(unreadable=1), "stream", Finding.WARNING),
        (counted(odd_stamps=1, backwards=2), "stream", Finding.WARNING),
        (counted(reconnects=1), "stream", Finding.FAULT),
        (counted(clock_jumps=1), "stream", Finding.FAULT),
    ],
)
def test_a_camera(facts: CameraFacts, name: str, finding: Finding):
    """Each shortcoming by itself."""
    assert of(list(judge_camera_run(facts)), name).finding is finding


@pytest.mark.parametrize(
    ("intrinsics", "finding"),
    [
        (CameraIntrinsics(640, 480, 385.0, 385.0, 319.5, 239.5), Finding.OK),
        (CameraIntrinsics(640, 480, 1400.0, 1400.0, 319.5, 239.5), Finding.FAULT),
        (CameraIntrinsics(640, 480, 385.0, 385.0, 160.0, 239.5), Finding.FAULT),
        (CameraIntrinsics(640, 480, 385.0, 400.0, 319.5, 239.5), Finding.WARNING),
    ],
)
def test_intrinsics_of_another_resolution_show(intrinsics: CameraIntrinsics, finding: Finding):
    """By the angle of view and by the centre."""
    assert judge_camera(intrinsics, "colour").finding is finding


def test_an_airframe_whose_camera_or_arm_cannot_be():
    """A camera that looks up, an arm that the propellers overtake."""
    up = replace(Airframe(), body_from_camera=Pose.identity())
    assert judge_airframe(up).finding is Finding.FAULT
    short = replace(Airframe(), body_from_tip=pose((0.3, 0, 0)))
    assert judge_airframe(short).finding is Finding.FAULT
    tight = replace(Airframe(), body_from_tip=pose((0.45, 0, 0)))
    assert judge_airframe(tight).finding is Finding.WARNING


def test_files_that_are_wrong_are_told_with_their_line(tmp_path: Path):
    """A certificate that has ended, a tuning file out of its bounds, a camera that is none."""
    ends = make_ends(tmp_path / "ends")
    ended = make_ending(ends, "drone-9", timedelta(days=-1))
    (tmp_path / "tuning.toml").write_text("[mission]\ndwell_s = 1e9")
    (tmp_path / "camera.json").write_text("{}")
    settings = ClientSettings(name="drone-1", tls=ended)
    checks = check_files(settings, None, tmp_path / "camera.json", tmp_path / "tuning.toml")
    assert of(checks, "airframe").finding is Finding.UNCHECKED
    for name, word in (
        ("certificates", "expired"),
        ("tuning", "dwell_s = 1000000000.0 is not in"),
        ("camera file", "camera.json"),
    ):
        check = of(checks, name)
        assert check.finding is Finding.FAULT
        assert word in check.found, check
    soon = make_ending(ends, "drone-8", timedelta(hours=20))
    check = of(
        check_files(ClientSettings(name="drone-8", tls=soon), None, None, None), "certificates"
    )
    assert check.finding is Finding.WARNING


def test_a_target_file_of_the_drones_own_eyes_is_read(tmp_path: Path):
    """Only where it has eyes of its own; what is wrong with it is told."""
    for target, finding in (("bullseye-200", Finding.OK), ("bulls", Finding.FAULT)):
        settings = ClientSettings(onboard_fallback=True, onboard_target=target)
        assert of(check_files(settings, None, None, None), "target").finding is finding
    settings = ClientSettings(onboard_target="bulls")
    assert of(check_files(settings, None, None, None), "target").finding is Finding.UNCHECKED


def test_this_machine_is_measured(tmp_path: Path):
    """Nothing is left behind, also where the folder is not there yet."""
    facts = collect_machine(tmp_path / "not" / "yet")
    assert facts.clock_step_ns > 0
    assert facts.free_bytes > 0
    assert facts.write_ms > 0
    assert list(tmp_path.iterdir()) == []


def test_without_anything_there_it_ends_and_says_so(tmp_path: Path):
    """Exit code 1, and what was not looked at is told."""
    arguments = ["doctor", "--connect", "tcp/127.0.0.1:1", "--wait-s", "0.1", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "RUN")])
    assert result.exit_code == 1
    report = json.loads(result.stdout)
    found = {(c["area"], c["name"]): c["finding"] for c in report["checks"]}
    assert found["service", "workers"] == "fault"
    assert found["vehicle", "autopilot"] == "not checked"
    assert found["camera", "pictures"] == "not checked"
    assert found["odometry", "topics"] == "not checked"
    assert len(found) == len(report["checks"]), "no two rows of one name"
    assert sum(report["counts"].values()) == len(report["checks"])
