"""``edge-service serve`` as a real process: start, serve, drain, and mistakes told in one line."""

from __future__ import annotations

import json
import os
import secrets
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
from rgbd_wire.probe import Probe, seal_probe
from rgbd_wire.streams import worker_key
from tests.integration.udp_drone import tunnelling
from tests.integration.zenoh_drone import flying
from tests.service_process import free_port, free_udp_port
from tests.unit.edge_service.edge_fakes import SECOND_NS, message

RECORDING = Path(__file__).parents[2] / "examples" / "recordings" / "rendered-approach"
FRAMES_WITH_TARGET = (20, 30, 44)
FRAME_WITHOUT_TARGET = 0
COMMAND = [sys.executable, "-c", "from edge_service.cli import main; main()", "serve"]
TIMEOUT_S = 60
KEY = bytes(range(32))


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


def sent(frame, sequence, drone="d1"):
    """The frame as a drone sends it."""
    return pack(compress(frame), FrameStamp(drone, 7, sequence, 0, 60 * SECOND_NS))


def environment():
    """This process's own, with none but our EDGE_ variables."""
    own = {k: v for k, v in os.environ.items() if not k.startswith("EDGE_")}
    return {**own, "EDGE_NAME": "w1", "EDGE_THREADS": "1"}


class Served:
    """A service process and where to reach it."""

    def __init__(self, *flags, **variables):
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        own = {"EDGE_ZENOH_LISTEN": self.endpoint, "EDGE_HTTP": "127.0.0.1:0"}
        self.process = subprocess.Popen(
            [*COMMAND, *flags],
            env=environment() | own | variables,
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
def served(*flags, **variables):
    service = Served(*flags, **variables)
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


@pytest.fixture
def keys(tmp_path):
    """A key file with two drones."""
    path = tmp_path / "keys"
    path.write_text(f"d1 {KEY.hex()}\nd2 {KEY.hex()}\n")
    path.chmod(0o600)
    return path


def drained(service, *drones, logged=""):
    """End the service, and check that every frame of every drone was acknowledged and answered."""
    service.process.send_signal(signal.SIGTERM)
    code, out, err = service.end()
    assert (code, out[-1]) == (0, "bye")
    assert err.count("\n") == bool(logged)
    assert logged in err
    for drone in drones:
        assert sorted(r.sequence for r in drone.results) == sorted(drone.acks)


def test_drones_on_both_networks_are_served_and_drained(keys):
    """Zenoh and the tunnel at once: true poses on both, drain told on both, nothing lost, 0."""
    udp = f"127.0.0.1:{free_udp_port()}"
    frame, truth = recorded(FRAMES_WITH_TARGET[0])
    position_m = np.array(truth["camera_from_target"])[:3, 3]
    with (
        served("--udp", udp, "--keys", str(keys)) as service,
        flying(service.endpoint) as by_zenoh,
        tunnelling(f"udp/{udp}", KEY, name="d2") as by_udp,
    ):
        assert any(line.startswith(f"udp    {udp}") for line in service.lines)
        for drone, name in ((by_zenoh, "d1"), (by_udp, "d2")):
            drone.send(sent(frame, 0, name))
            drone.wait_for(lambda d: d.results)
            found = drone.results[0]
            assert (found.drone, found.outcome) == (name, Outcome.TARGET)
            np.testing.assert_allclose(found.target.camera_from_target[:3], position_m, atol=0.03)
        by_udp.probe(seal_probe(Probe(boot_id=7, sequence=1, t1_ns=5)))
        by_udp.wait_for(lambda d: d.echoes and d.statuses)
        echo, status = by_udp.echoes[0], by_udp.statuses[-1]
        assert echo.worker_boot_id == status.worker_boot_id == by_udp.results[0].worker_boot_id
        assert echo.t2_ns <= echo.t3_ns
        # A key is of one drone: it does not speak for another
        by_udp.send(sent(frame, 1, "d1"))
        metrics = f"{service.url}/metrics"
        for _ in range(100):  # it is not answered: each status is a moment to look again
            text, n = httpx.get(metrics).text, len(by_udp.statuses)
            if 'reason="wrong_drone"} 1.0' in text:
                break
            by_udp.wait_for(lambda d, n=n: len(d.statuses) > n)
        assert 'edge_rejected_total{reason="wrong_drone"} 1.0' in text
        assert 'edge_tunnel_refused_total{reason="bad_mac"} 0.0' in text
        assert "edge_probes_total 1.0" in text
        for sequence in range(2, 6):
            for drone, name in ((by_zenoh, "d1"), (by_udp, "d2")):
                drone.send(message(drone=name, sequence=sequence, budget_ns=60 * SECOND_NS))
                drone.wait_for(lambda d, n=sequence: d.acks[-1] == n)
        drained(service, by_zenoh, by_udp, logged="a frame of d1 came from d2")
        assert by_udp.statuses[-1].draining
        assert len(by_udp.acks) == len(by_zenoh.acks) == 5


def test_the_tunnel_alone(keys):
    """Without Zenoh: no port of it is opened, and drones are served all the same."""
    udp = f"127.0.0.1:{free_udp_port()}"
    variables = {"EDGE_UDP_LISTEN": udp, "EDGE_TUNNEL_KEYS": str(keys), "EDGE_ZENOH_LISTEN": ""}
    with served(**variables) as service, tunnelling(f"udp/{udp}", KEY) as drone:
        assert not any(line.startswith("zenoh") for line in service.lines)
        assert httpx.get(f"{service.url}/readyz").json()["ready"]
        drone.send(message(budget_ns=60 * SECOND_NS))
        drone.wait_for(lambda d: d.results)
        drained(service, drone)


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
    monkeypatch.setenv("EDGE_ZENOH_LISTEN", f"tcp/127.0.0.1:{free_port()}")
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
    assert "packaged: bullseye-200, bullseye-400" in failing("--target", "bullseye-999")
    assert str(tmp_path / "keys") in failing(
        "--udp", "127.0.0.1:0", "--keys", str(tmp_path / "keys")
    )
    assert str(tmp_path / "ca.pem") in failing("--tls", str(tmp_path))
    keys = tmp_path / "keys"
    keys.write_text(f"d {secrets.token_hex(32)}\n")
    keys.chmod(0o600)
    assert "udp/a..b:1: not a host name" in failing("--udp", "a..b:1", "--keys", str(keys))
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
