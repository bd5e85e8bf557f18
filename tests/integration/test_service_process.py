"""``edge-service serve`` as a real process: start, serve, drain, and mistakes told in one line."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import httpx
import imagecodecs
import numpy as np
import pytest

from edge_service.cli import main
from rgbd_wire.camera import load_camera
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import FrameStamp, compress, pack
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Outcome
from rgbd_wire.streams import worker_key
from tests.integration.zenoh_drone import flying
from tests.service_process import free_port
from tests.unit.edge_service.edge_fakes import SECOND_NS, message

RECORDING = Path(__file__).parents[2] / "examples" / "recordings" / "rendered-approach"
FRAMES_WITH_TARGET = (20, 30, 44)
FRAME_WITHOUT_TARGET = 0
COMMAND = [sys.executable, "-c", "from edge_service.cli import main; main()", "serve"]
TIMEOUT_S = 60


def recorded(index):
    """One frame of the recording that ships with the project, and its truth."""
    stem = (RECORDING / "rgb.txt").read_text().splitlines()[1 + index].split()[0]
    color = imagecodecs.imread(RECORDING / "rgb" / f"{stem}.jpg")
    depth = imagecodecs.imread(RECORDING / "depth" / f"{stem}.png")
    pose = (RECORDING / "groundtruth.txt").read_text().splitlines()[1 + index].split()
    x, y, z, qx, qy, qz, qw = map(float, pose[1:])
    world_from_camera = Pose(np.array([x, y, z]), np.array([qw, qx, qy, qz]))
    frame = RgbdFrame(color, depth, load_camera(RECORDING / "camera.json"), 0, world_from_camera)
    return frame, json.loads((RECORDING / "truth.json").read_text())[index]


def sent(frame, sequence):
    """The frame as a drone sends it."""
    return pack(compress(frame), FrameStamp("d1", 7, sequence, 0, 60 * SECOND_NS))


def environment():
    """This process's own, with none but our EDGE_ variables."""
    own = {k: v for k, v in os.environ.items() if not k.startswith("EDGE_")}
    return {**own, "EDGE_NAME": "w1", "EDGE_THREADS": "1"}


class Served:
    """A service process and where to reach it."""

    def __init__(self):
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.process = subprocess.Popen(
            [*COMMAND, "--listen", self.endpoint, "--http", "127.0.0.1:0"],
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines = []
        for line in self.process.stdout:
            self.lines.append(line.rstrip())
            if line.startswith("ready"):
                break
        else:
            raise AssertionError(f"never ready: {self.lines} {self.process.stderr.read()}")
        http = next(line for line in self.lines if line.startswith("http"))
        self.url = http.split()[1]

    def end(self):
        """Exit code, what it still said, and its errors."""
        out, err = self.process.communicate(timeout=TIMEOUT_S)
        return self.process.returncode, out.splitlines(), err


@contextmanager
def served():
    service = Served()
    try:
        yield service
    finally:
        if service.process.poll() is None:
            service.process.kill()
        service.process.communicate()


def test_it_finds_the_target_and_drains():
    """The real thing: ready, true poses over the link and over HTTP, SIGTERM, nothing lost, 0."""
    with served() as service, flying(service.endpoint) as drone:
        assert service.endpoint in "\n".join(service.lines)
        assert httpx.get(f"{service.url}/readyz").json()["ready"]
        drone.wait_for(lambda d: d.workers.get(worker_key("w1")))
        for n, index in enumerate(FRAMES_WITH_TARGET):
            frame, truth = recorded(index)
            camera_from_target = np.array(truth["camera_from_target"])
            drone.send(sent(frame, n))
            drone.wait_for(lambda d, n=n: len(d.results) == n + 1)
            assert drone.results[n].outcome is Outcome.TARGET
            found = drone.results[n].target
            np.testing.assert_allclose(
                found.camera_from_target[:3], camera_from_target[:3, 3], atol=0.03
            )
            world = frame.world_from_camera @ Pose.from_matrix(camera_from_target)
            np.testing.assert_allclose(found.world_from_target[:3], world.translation, atol=0.03)
        response = httpx.post(
            f"{service.url}/v1/localize",
            files={
                "color": imagecodecs.png_encode(frame.color_rgb),
                "depth": imagecodecs.png_encode(frame.depth_units),
                "camera": (RECORDING / "camera.json").read_bytes(),
            },
            timeout=TIMEOUT_S,
        )
        position_m = response.json()["target"]["camera_from_target"]["translation_m"]
        np.testing.assert_allclose(position_m, camera_from_target[:3, 3], atol=0.03)
        frame, truth = recorded(FRAME_WITHOUT_TARGET)
        assert truth["visible"] == 0
        drone.send(sent(frame, 10))
        drone.wait_for(lambda d: d.results[-1].sequence == 10)
        assert drone.results[-1].outcome in {Outcome.NOTHING_FOUND, Outcome.NOT_A_TARGET}
        for sequence in range(11, 17):
            drone.send(message(sequence=sequence, budget_ns=60 * SECOND_NS))
        service.process.send_signal(signal.SIGTERM)
        code, out, err = service.end()
        assert (code, out[-1], err) == (0, "bye", "")
        drone.wait_for(lambda d: d.workers[worker_key("w1")] is False)
        assert sorted(r.sequence for r in drone.results) == sorted(drone.acks)
        assert Outcome.FAILED not in {r.outcome for r in drone.results}


def test_a_second_signal_forces_the_end():
    """Whoever presses Ctrl-C twice does not want to wait for the drain."""
    with served() as service:
        service.process.send_signal(signal.SIGINT)
        for line in service.process.stdout:
            if line.startswith("drain"):
                break
        service.process.send_signal(signal.SIGINT)
        code, _, err = service.end()
    assert (code, err) in {(130, "edge-service: stopped by force\n"), (0, "")}


@pytest.fixture
def failing(monkeypatch, capsys):
    """Runs the command in this process, where it must fail; gives its one line."""

    def run(*flags, **variables):
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(sys, "argv", ["edge-service", "serve", *flags])
        with pytest.raises(SystemExit) as ended:
            main()
        err = capsys.readouterr().err
        assert ended.value.code == 2
        assert err.startswith("edge-service: ")
        assert err.count("\n") == 1
        return err

    monkeypatch.setenv("EDGE_THREADS", "1")
    monkeypatch.setenv("EDGE_HTTP", "127.0.0.1:0")
    return run


def test_taken_ports_are_one_line(failing):
    """Which address, that it is taken, and which flag gives another one; exit code 2."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        line = failing("--http", f"127.0.0.1:{port}")
        assert f"HTTP on 127.0.0.1:{port}: Address already in use; " in line
        assert "--http or EDGE_HTTP" in line
        line = failing("--listen", f"tcp/127.0.0.1:{port}")
        assert f"Zenoh on tcp/127.0.0.1:{port}: Address already in use; " in line
        assert "--listen or EDGE_ZENOH_LISTEN" in line


def test_what_cannot_be_loaded_is_one_line(failing, tmp_path):
    """A wrong weights file, a wrong target, a wrong variable: what, where, what to do."""
    junk = tmp_path / "junk.safetensors"
    junk.write_bytes(b"junk")
    assert str(junk) in failing("--weights", str(junk))
    assert str(tmp_path / "none") in failing("--weights", str(tmp_path / "none"))
    assert "packaged: bullseye-400" in failing("--target", "bullseye-999")
    assert "did you mean EDGE_WEIGHTS?" in failing(EDGE_WEIHGTS="x")


def test_sigterm_while_it_still_loads_ends_it_at_once():
    """Before the service can drain there is nothing to drain: exit 0, without waiting for torch."""
    early = (
        "import os, signal, threading\n"
        "from edge_service.cli import main\n"
        "threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGTERM)).start()\n"
        "main()\n"
    )
    command = [sys.executable, "-c", early, "serve", "--http", f"127.0.0.1:{free_port()}"]
    command += ["--listen", f"tcp/127.0.0.1:{free_port()}"]
    run = subprocess.run(
        command, env=environment(), capture_output=True, timeout=TIMEOUT_S, check=False
    )
    assert run.returncode == 0, run.stderr
    assert b"ready" not in run.stdout + run.stderr
