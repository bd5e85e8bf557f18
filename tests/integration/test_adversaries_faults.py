"""What breaks around a flight: a suspended process, a full disk, clocks that disagree."""

from __future__ import annotations

import ast
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.integration.hostile import Service
from tests.recordings import RECORDING, long_recording
from tests.two_workers import INTERRUPTED, Flying

ROOT = Path(__file__).parents[2]
NAME = "d1"
TAU_MAX_MS, AGE_MAX_MS = 600, 800
"""Generous: a worker, a drone and this test share two busy cores."""
PATIENT = ("--name", NAME, "--tau-max-ms", str(TAU_MAX_MS), "--age-max-ms", str(AGE_MAX_MS))
ENOUGH = 10
SUSPENDED_S = 3.0
HOUR_S = 3600
DISK_FULL = 2
"""Exit code of a flight whose summary could not be written."""


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    service = Service(tmp_path_factory.mktemp("faults"))
    service.process.start()
    try:
        service.process.wait_ready()
        yield service
    finally:
        service.process.kill()


def may(*namespaces: str) -> bool:
    """Whether this machine lets us make such namespaces."""
    done = subprocess.run(["unshare", *namespaces, "true"], capture_output=True, check=False)
    return done.returncode == 0


def replay(service, recording, out, *options, within=()):
    """A whole flight; ``within``: the command that it is started by."""
    client = Path(sys.executable).with_name("drone-client")
    command = [client, "replay", recording, "--connect", service.udp, "--key-file", service.keys]
    command += ["--out", out, "--no-plot", "--json", *PATIENT, *options]
    return subprocess.run(
        [str(part) for part in (*within, *command)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


@pytest.mark.parametrize("network", ["udp", "zenoh"])
def test_a_suspended_drone_accepts_nothing_old(service, tmp_path, network):
    """Stopped for 3 s with answers under way: these are refused, then the flight goes on."""
    connect = service.udp if network == "udp" else service.process.endpoint
    pair = SimpleNamespace(connect=connect, keys=service.keys)
    flying = Flying(tmp_path, pair, PATIENT)
    try:
        flying.wait_for_accepted(ENOUGH)
        flying.process.send_signal(signal.SIGSTOP)
        stopped_ns = time.monotonic_ns()
        time.sleep(SUSPENDED_S)  # the fault itself
        resumed_ns = time.monotonic_ns()
        flying.process.send_signal(signal.SIGCONT)
        flying.wait_for_accepted(ENOUGH)
        run = flying.land()
    finally:
        flying.close()
    assert run.exit_code == INTERRUPTED
    accepted = run.accepted()
    after = [f for f in accepted if f["t4_ns"] >= resumed_ns]
    assert after
    assert all(f["t_capture_ns"] > stopped_ns for f in after)
    assert all((f["t4_ns"] - f["t_capture_ns"]) / 1e6 <= AGE_MAX_MS for f in accepted)
    # Control wakes up with a target that is 3 s old: it says so, and knows a fresh one again later
    waking = [t for t in run.ticks if t["t_ns"] >= resumed_ns]
    assert waking[0].get("freshness") != "fresh"
    assert waking[-1]["t_ns"] > after[-1]["t_capture_ns"]
    assert run.summary["control_errors"] == 0


def answered(service) -> float:
    """Frames that the service has answered."""
    return sum(n for m, n in service.metrics().items() if m.startswith("edge_frames_total"))


@pytest.mark.skipif(not may("-m"), reason="needs a mount namespace")
def test_a_full_disk_costs_lines_and_nothing_else(service, tmp_path):
    """24 kB under the ledger: every frame is still sent and answered, lost lines are counted."""
    disk = tmp_path / "disk"
    disk.mkdir()
    listed = (RECORDING / "rgb.txt").read_text().splitlines()
    frames = sum(not line.startswith("#") for line in listed)
    before = answered(service)
    mount = 'mount -t tmpfs -o size=24k none "$0" && exec "$@"'
    done = replay(
        service,
        RECORDING,
        disk / "run",
        "--as-fast-as-possible",
        within=("unshare", "-m", "sh", "-c", mount, disk),
    )
    assert done.returncode == DISK_FULL, done.stderr
    assert "Traceback" not in done.stderr
    summary = json.loads(done.stdout)
    assert answered(service) - before == frames
    # The summary speaks of the lines that are there, and says that others are not
    assert 0 < summary["frames"] < frames
    assert summary["lost_ledger_lines"] >= frames - summary["frames"]
    assert summary["fates"] == {"answered": summary["frames"]}
    assert summary["control_errors"] == 0
    assert any("No space left" in line for line in summary["unwritten"])


@pytest.mark.skipif(not may("-T", "--monotonic", "1"), reason="needs a time namespace")
def test_the_accepted_set_knows_no_clock_but_the_drones(service, tmp_path):
    """The drone's clock an hour before the worker's, the same, an hour after it: one result."""
    back_s = min(HOUR_S, int(time.monotonic()) - 60)  # it may not come to lie before its zero
    accepted = {}
    for offset_s in (0, HOUR_S, -back_s):
        offsets = ("--monotonic", str(offset_s), "--boottime", str(offset_s))
        out = tmp_path / f"run{offset_s}"
        within = ("unshare", "-T", *offsets)
        done = replay(service, RECORDING, out, "--as-fast-as-possible", within=within)
        assert done.returncode == 0, done.stderr
        lines = [json.loads(line) for line in (out / "ledger.jsonl").read_text().splitlines()]
        skew_s = lines[0]["t_capture_ns"] / 1e9 - time.monotonic()
        assert abs(skew_s - offset_s) < 60
        accepted[offset_s] = [
            (f["sequence"], f["outcome"]) for f in lines if f.get("verdict") == "accepted"
        ]
    assert len(accepted[0]) > ENOUGH
    assert accepted[HOUR_S] == accepted[0]
    assert accepted[-back_s] == accepted[0]


WALL_CLOCKS = {"time.time", "time.time_ns", "datetime.now", "datetime.utcnow", "datetime.today"}
MAY_ASK = {
    "rgbd_wire/tls_files.py",  # certificates end on a date
    "drone_client/ros",  # a ROS message carries the time of day, for others to read
    "drone_client/odometry/zenoh.py",  # ROS's stamps are of the time of day; goes to the autopilot
    "edge_service/json_log.py",  # a log's lines carry the time of day
}


def wall_clocks_in(source: str) -> set[str]:
    """Wall clocks that a module asks, by name; those handed on without a call count as well."""
    return {
        text
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute)
        and (text := ast.unparse(node)).endswith(tuple(WALL_CLOCKS))
        or isinstance(node, ast.Attribute)
        and (text := ast.unparse(node)).endswith("CLOCK_REALTIME")
    }


def test_nothing_on_the_way_of_a_frame_asks_the_wall_clock():
    """A step of the time of day cannot matter: only modules off the frame's way ask for it."""
    assert wall_clocks_in("import time\nx = time.time_ns\ny = time.monotonic()") == {"time.time_ns"}
    asking = {
        str(path.relative_to(ROOT))
        for package in ("rgbd_wire", "target_pose", "edge_service", "drone_client")
        for path in (ROOT / package).rglob("*.py")
        if wall_clocks_in(path.read_text())
    }
    assert not {path for path in asking if not path.startswith(tuple(MAY_ASK))}


def test_long_recordings_outlast_the_faults(tmp_path):
    """The flights above end by Ctrl-C and not by themselves."""
    stamps = (long_recording(tmp_path / "long") / "rgb.txt").read_text().splitlines()
    assert float(stamps[-1].split()[0]) - float(stamps[1].split()[0]) > 60
