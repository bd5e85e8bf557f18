"""A real service with certificates and tunnel keys, and drones that come in over both links."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from datetime import timedelta
from pathlib import Path

import pytest

from tests.certificates import make_ending, make_ends
from tests.deploy.manifests import ROOT
from tests.service_process import ServiceProcess, free_port, free_udp_port

RECORDING = ROOT / "examples/recordings/rendered-approach"


@pytest.fixture(scope="module")
def ends(tmp_path_factory):
    """Folders of two drones and a worker under one authority, with tunnel keys."""
    return make_ends(tmp_path_factory.mktemp("ends"))


@pytest.fixture(scope="module")
def tunnel():
    """Where the worker's tunnel listens."""
    return f"127.0.0.1:{free_udp_port()}"


@pytest.fixture(scope="module")
def service(ends, tunnel, tmp_path_factory):
    """A service that takes drone-1 over TLS, and whoever has a key over the tunnel."""
    home = ends / "worker-a"
    service = ServiceProcess(
        tmp_path_factory.mktemp("service"),
        "worker-a",
        {
            "EDGE_ZENOH_TLS": str(home),
            "EDGE_ZENOH_DRONES": "drone-1",
            "EDGE_UDP_LISTEN": tunnel,
            "EDGE_TUNNEL_KEYS": str(home / "tunnel.keys"),
        },
    )
    service.endpoint = f"tls/localhost:{free_port()}"
    service.start()
    try:
        service.wait_ready()
        yield service
        assert service.stop() == 0
    finally:
        if service.process.poll() is None:
            service.kill()


def replay(out, **env):
    """A drone's process that plays a recording to its end."""
    client = Path(sys.executable).with_name("drone-client")
    command = [client, "replay", RECORDING, "--out", out, "--no-plot", "--as-fast-as-possible"]
    # The machine may be busy with other things: this is about who gets in, not about how fast
    bounds = {"DRONE_TAU_MAX_MS": "5000", "DRONE_AGE_MAX_MS": "9000"}
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | bounds | env
    )


def accepted(out):
    """Results that the gate let through."""
    return json.loads((out / "summary.json").read_text())["verdicts"]["accepted"]


def test_a_drone_is_served_over_tls(service, ends, tmp_path):
    """The chain as it is flown, with the certificate of its own name."""
    home = ends / "drone-1"
    ended = replay(
        tmp_path / "run",
        DRONE_NAME="drone-1",
        DRONE_TLS=str(home),
        DRONE_CONNECT=service.endpoint,
    )
    assert ended.returncode == 0, ended.stderr
    assert accepted(tmp_path / "run") > 0


def test_a_drone_is_served_over_the_tunnel(service, tunnel, ends, tmp_path):
    """The same service, the other link, the key that was made beside the certificate."""
    ended = replay(
        tmp_path / "run",
        DRONE_NAME="drone-2",
        DRONE_KEY_FILE=str(ends / "drone-2" / "tunnel.key"),
        DRONE_CONNECT=f"udp/{tunnel}",
    )
    assert ended.returncode == 0, ended.stderr
    assert accepted(tmp_path / "run") > 0


def test_a_drone_that_the_worker_does_not_name_finds_no_worker(service, ends, tmp_path):
    """Its certificate is good and its name is not on the list: one line, and no answer."""
    ended = replay(
        tmp_path / "run",
        DRONE_NAME="drone-2",
        DRONE_TLS=str(ends / "drone-2"),
        DRONE_CONNECT=service.endpoint,
        DRONE_WAIT_FOR_WORKER_S="2",
    )
    assert ended.returncode != 0
    told = " ".join(ended.stderr.split())
    assert "no worker answers" in told
    assert "it takes our certificate; is this drone among EDGE_ZENOH_DRONES" in told


def test_an_expired_certificate_ends_both_programs_with_one_line(service, ends, tmp_path):
    """Before anything is opened, with the name of the file."""
    ending = make_ending(ends, "drone-1", -timedelta(hours=1))
    ended = replay(
        tmp_path / "run",
        DRONE_NAME="drone-1",
        DRONE_TLS=str(ending),
        DRONE_CONNECT=service.endpoint,
    )
    assert ended.returncode != 0
    assert "expired on" in " ".join(ended.stderr.split())
    worker = ServiceProcess(
        tmp_path, "worker-a", {"EDGE_ZENOH_TLS": str(ending), "EDGE_ZENOH_DRONES": "drone-1"}
    )
    worker.endpoint = f"tls/localhost:{free_port()}"
    worker.start()
    assert worker.process.wait(60) != 0
    assert "expired on" in worker.log.read_text()
    assert "Traceback" not in worker.log.read_text() + ended.stderr
