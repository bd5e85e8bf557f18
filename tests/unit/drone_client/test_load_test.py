"""The load test: drones over real sessions, and numbers that add up."""

from __future__ import annotations

import inspect
import json
import os
import sys
import threading
from collections import Counter

import cv2
import numpy as np
import pytest

from drone_client import load_test
from drone_client.link import zenoh as link_zenoh
from drone_client.load_test import LoadDrone, LoadTally, summarise_load
from drone_client.settings import ClientSettings
from edge_service.transport.zenoh import ZenohAddress, ZenohTransport
from rgbd_wire.clock import ManualClock, MonotonicClock
from rgbd_wire.frame_codec import compress, decompress, unpack
from rgbd_wire.tls_files import tls_files
from tests.certificates import make_ends
from tests.service_process import free_port
from tests.unit.drone_client.builders import CAMERA, MS, SECOND, answering, eventually, frame
from tests.unit.drone_client.zenoh_worker import ZenohWorker

PICTURES = [compress(frame())]


@pytest.fixture(autouse=True)
def as_it_was(monkeypatch):
    """No DRONE_ variables; OpenCV's log as before."""
    for name in list(os.environ):
        if name.startswith("DRONE_"):
            monkeypatch.delenv(name)
    # A machine that stands still for a while loses no link
    monkeypatch.setitem(link_zenoh._CONFIG, "transport/link/tx/lease", 60_000)
    level = cv2.utils.logging.getLogLevel()
    yield
    cv2.utils.logging.setLogLevel(level)


@pytest.fixture(scope="module")
def worker():
    """A worker that answers every frame at once."""
    worker = ZenohWorker(answer=answering())
    yield worker
    worker.close()


@pytest.fixture
def command(monkeypatch, capfd):
    """Runs ``load-test`` in this process; exit code, stdout, stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["load-test", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            load_test.main()
        out, err = capfd.readouterr()
        return int(ended.value.code or 0), out, err

    return run


def test_two_drones_are_answered_and_the_numbers_add_up(command, worker, monkeypatch):
    """Every frame due was sent or held back; every frame sent was answered or is missing."""
    monkeypatch.setenv("DRONE_AGE_MAX_MS", "5000")  # a busy machine makes no frame late
    code, out, _ = command(
        "--drones", 2, "--rate", 40, "--duration", 3, "--connect", worker.endpoint,
        "--tau-max-ms", 5000, "--json",
    )  # fmt: skip
    assert code == 0
    s = json.loads(out)
    assert s["drones"] == 2
    assert s["frames_due"] == s["frames_sent"] + s["skipped_window_full"]
    assert s["frames_due"] >= 10
    assert s["frames_sent"] > 2 * 2  # answers open the windows again
    answers = sum(s["outcomes"].values())
    assert 0 < answers <= s["frames_sent"]
    assert s["workers"] == {"w1": answers}
    assert s["processed_per_s"] == pytest.approx(answers / s["seconds"], rel=0.01)
    header = unpack(worker.frames.get(timeout=10)).header
    assert header.drone in ("load-0", "load-1")
    assert (header.color.width, header.color.height) == (640, 480)


def test_a_table_is_what_people_get(command, worker):
    """Percentiles and counts, in words."""
    code, out, _ = command("--drones", 1, "--duration", 0.5, "--connect", worker.endpoint)
    assert code == 0
    for word in ("load test", "round_trip_ms", "p99", "frames_sent", "verdicts"):
        assert word in out


def test_every_flag_can_be_read_at_80_columns(command, monkeypatch):
    """None is cut short, and no line is longer than the terminal."""
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = command("--help")
    assert code == 0
    for name in inspect.signature(load_test.load_test).parameters:
        flag = "--json" if name == "as_json" else f"--{name.replace('_', '-')}"
        assert f"  {flag} " in out
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--connect", "edge:7447"], "did you mean tcp/edge:7447?"),
        (["--recording", "no-such-folder"], "recording no-such-folder: no such folder"),
        (["--window", "0"], "--window = 0"),
        ([], "no worker answers at tcp/127.0.0.1:"),
    ],
)
def test_a_mistake_is_one_line_on_stderr_and_exit_code_2(command, monkeypatch, arguments, says):
    """As with drone-client."""
    monkeypatch.setenv("DRONE_WAIT_FOR_WORKER_S", "0")
    monkeypatch.setenv("DRONE_CONNECT", f"tcp/127.0.0.1:{free_port()}")
    code, out, err = command(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("load-test: ")
    assert says in err
    assert err.count("\n") == 1


def test_each_drone_shows_a_certificate_of_its_own(command, tmp_path):
    """Two drones of a folder that scripts/certificates makes, and one of its own folder."""
    ends = make_ends(tmp_path / "ends", drones=("load-0", "load-1"))
    endpoint = f"tls/localhost:{free_port()}"
    tls = tls_files(ends / "worker-a")
    address = ZenohAddress(
        listen=(endpoint,), tls=tls, drones=("load-0", "load-1"), lease_ms=60_000
    )
    transport = ZenohTransport("worker-a", address)
    transport.open()
    heard = set()
    try:
        transport.start(lambda drone, *_: heard.add(drone))
        transport.announce()
        arguments = ("--duration", 3, "--connect", endpoint, "--tls")
        code, out, err = command("--drones", 2, *arguments, ends, "--json")
        assert (code, err) == (0, "")
        assert json.loads(out)["frames_sent"] >= 2
        assert heard == {"load-0", "load-1"}
        assert command("--drones", 1, *arguments, ends / "load-0")[0] == 0
        code, _, err = command("--drones", 3, *arguments, ends)
    finally:
        transport.close()
    assert code == 2
    assert f"there is no folder {ends / 'load-2'}, and 3 drones need one each" in err
    assert err.count("\n") == 1


def test_pictures_come_from_a_recording_evenly_and_at_most_32(tmp_path):
    """Compressed once; they repeat."""
    (tmp_path / "rgb").mkdir()
    for i in range(70):
        cv2.imwrite(str(tmp_path / f"rgb/{i}.png"), np.full((12, 16, 3), i, np.uint8))
    (tmp_path / "rgb.txt").write_text("".join(f"{i}.0 rgb/{i}.png\n" for i in range(70)))
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA.to_json()))
    pictures = load_test._pictures(tmp_path, None, 100)
    shades = [int(p.frame.color_rgb[0, 0, 0]) for p in pictures]
    assert len(shades) <= load_test.MAX_PICTURES
    assert shades == list(range(0, 70, shades[1]))


def test_without_a_recording_the_picture_weighs_what_a_real_one_does():
    """640x480, depth on a stereo sensor's lattice, tens of kilobytes."""
    (picture,) = load_test._pictures(None, None, 80)
    assert picture.frame.color_rgb.shape == (480, 640, 3)
    assert picture.depth.table == "lattice"
    assert 20_000 < picture.size_bytes < 300_000


@pytest.fixture
def drone(worker):
    """A drone with window 2 on a clock that stands still; it hears nothing by itself."""
    silent = ZenohWorker("silent")
    clock = ManualClock(10 * SECOND)
    settings = ClientSettings(connect=silent.endpoint, window=2, ack_timeout_ms=500)
    drone = LoadDrone("load-0", settings, PICTURES, clock)
    assert eventually(lambda: drone.link.workers() == ("silent",))
    yield drone, clock, silent
    drone.link.close()
    silent.close()


def test_a_full_window_holds_frames_back_and_a_timeout_opens_it(drone):
    """Back-pressure is counted, not queued; each frame is stamped when it goes."""
    one, clock, silent = drone
    for sequence in range(4):
        one._send_one(sequence)
    assert (one.tally.due, one.tally.sent, one.tally.skipped) == (4, 2, 2)
    clock.advance(500 * MS)
    one._send_one(4)
    assert (one.tally.sent, one.tally.timeouts) == (3, 2)
    packed = [unpack(silent.frames.get(timeout=10)) for _ in range(3)]
    assert [p.header.sequence for p in packed] == [0, 1, 4]
    assert packed[2].header.t_capture_ns == 10 * SECOND + 500 * MS
    np.testing.assert_array_equal(decompress(packed[0]).depth_units, frame().depth_units)


def test_a_drone_stops_when_it_is_told_to(worker):
    """In the middle of an hour at one frame in ten seconds."""
    settings = ClientSettings(connect=worker.endpoint)
    clock = MonotonicClock()
    drone = LoadDrone("load-0", settings, PICTURES, clock)
    stop = threading.Event()
    until_ns = clock.now_ns() + 3600 * SECOND
    thread = threading.Thread(target=drone.run, args=(0.1, 0.9, until_ns, stop), daemon=True)
    thread.start()
    stop.set()
    thread.join(10)
    assert not thread.is_alive()
    drone.link.close()


def test_the_summary_adds_up_all_drones():
    """Counts are sums, times are of all, throughput is per drone; superseded is not processed."""
    a = LoadTally(
        due=10,
        sent=8,
        skipped=2,
        verdicts=Counter(accepted=6, too_old=1),
        outcomes=Counter(target=5, superseded=2),
        workers=Counter(w1=7),
        round_trip_ms=[10.0, 20.0],
        network_ms=[1.0],
        service_ms=[9.0],
    )
    b = LoadTally(due=10, sent=10, timeouts=3, outcomes=Counter(nothing_found=10))
    s = summarise_load([a, b], seconds=5.0)
    assert (s["frames_due"], s["frames_sent"]) == (20, 18)
    assert (s["skipped_window_full"], s["ack_timeouts"]) == (2, 3)
    assert s["verdicts"] == {"accepted": 6, "too_old": 1}
    assert s["outcomes"] == {"nothing_found": 10, "target": 5, "superseded": 2}
    assert s["processed_per_s"] == 3.0
    assert s["processed_per_s_and_drone"]["max"] == 2.0
    assert s["round_trip_ms"]["p50"] == 15.0
    assert summarise_load([b], 5.0)["round_trip_ms"] is None
