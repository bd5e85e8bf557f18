"""``edge-service serve`` as a real process: start, serve, drain, and mistakes told in one line."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import httpx
import imagecodecs
import pytest

from edge_service.cli import main
from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.weights import save_weights
from rgbd_wire.messages import Outcome
from rgbd_wire.streams import worker_key
from target_pose.target import Level
from tests.integration.zenoh_drone import flying, free_port
from tests.unit.edge_service.edge_fakes import CAMERA_JSON, COLOR, SECOND_NS, message

COMMAND = [sys.executable, "-c", "from edge_service.cli import main; main()", "serve"]
TIMEOUT_S = 60
BUDGET_NS = 60 * SECOND_NS
WORKED_ON = {Outcome.NOTHING_FOUND, Outcome.NOT_A_TARGET, Outcome.REFUSED, Outcome.TARGET}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A net that has learnt nothing: what it finds is not the subject here."""
    path = tmp_path_factory.mktemp("weights") / "untrained.safetensors"
    save_weights(path, TargetNet(NetConfig(tuple(level.value for level in Level), 4)), "none")
    return path


def environment(**variables):
    """This process's own, without its EDGE_ variables."""
    own = {k: v for k, v in os.environ.items() if not k.startswith("EDGE_")}
    return {**own, "EDGE_NAME": "w1", "EDGE_THREADS": "1", **variables}


class Served:
    """A service process and where to reach it."""

    def __init__(self, weights: Path, **variables):
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.process = subprocess.Popen(
            [*COMMAND, "--listen", self.endpoint, "--http", "127.0.0.1:0"],
            env=environment(EDGE_WEIGHTS=str(weights), **variables),
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
def served(weights, **variables):
    service = Served(weights, **variables)
    try:
        yield service
    finally:
        if service.process.poll() is None:
            service.process.kill()
        service.process.communicate()


def test_it_says_what_it_does_serves_and_drains(weights):
    """Ready, frames and a picture served, then SIGTERM: token down, every ack answered, exit 0."""
    with served(weights) as service, flying(service.endpoint) as drone:
        assert service.endpoint in "\n".join(service.lines)
        assert httpx.get(f"{service.url}/readyz").json()["ready"]
        drone.wait_for(lambda d: d.workers.get(worker_key("w1")))
        drone.send(message(budget_ns=BUDGET_NS))
        drone.wait_for(lambda d: len(d.results) == 1)
        assert drone.results[0].outcome in WORKED_ON
        response = httpx.post(
            f"{service.url}/v1/localize",
            files={"color": imagecodecs.png_encode(COLOR), "camera": CAMERA_JSON.encode()},
            timeout=TIMEOUT_S,
        )
        assert response.status_code == 200
        for sequence in range(1, 21):
            drone.send(message(sequence=sequence, budget_ns=BUDGET_NS))
        service.process.send_signal(signal.SIGTERM)
        code, out, err = service.end()
        assert (code, out[-1], err) == (0, "bye", "")
        drone.wait_for(lambda d: d.workers[worker_key("w1")] is False)
        assert sorted(r.sequence for r in drone.results) == sorted(drone.acks)
        turned_away = {Outcome.SUPERSEDED, Outcome.DRAINING}
        assert {r.outcome for r in drone.results} <= WORKED_ON | turned_away


def test_a_second_signal_forces_the_end(weights):
    """Whoever presses Ctrl-C twice does not want to wait for the drain."""
    with served(weights) as service:
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


def test_taken_ports_are_one_line(failing, weights):
    """Which address, that it is taken, and which flag gives another one; exit code 2."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        line = failing("--weights", str(weights), "--http", f"127.0.0.1:{port}")
        assert f"HTTP on 127.0.0.1:{port}: Address already in use; " in line
        assert "--http or EDGE_HTTP" in line
        line = failing("--weights", str(weights), "--listen", f"tcp/127.0.0.1:{port}")
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
