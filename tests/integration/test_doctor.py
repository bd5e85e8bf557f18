"""The doctor beside real ends: a service process, and a PX4-like process with a wrong parameter."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.px4_process import PeerProcess
from tests.service_process import free_udp_port, service_process

ROOT = Path(__file__).parents[2]


def examined(*arguments: str) -> tuple[int, dict[tuple[str, str], dict]]:
    """Exit code, and the checks by area and name."""
    command = [str(Path(sys.executable).with_name("drone-client")), "doctor", "--json", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stderr == ""
    return done.returncode, {(c["area"], c["name"]): c for c in json.loads(done.stdout)["checks"]}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """One look at everything that can be there without a drone."""
    folder = tmp_path_factory.mktemp("doctor")
    port = free_udp_port()
    peer = PeerProcess("--udp", f"127.0.0.1:{port}")
    try:
        with service_process(folder) as service:
            return examined(
                "--autopilot",
                f"udp/127.0.0.1:{port}",
                "--airframe",
                str(ROOT / "examples" / "airframe.toml"),
                "--connect",
                service.endpoint,
                "--url",
                f"http://{service.http}",
                "--wait-s",
                "30",
                "--out",
                str(folder / "RUN"),
            )
    finally:
        peer.close()


def test_the_service_is_found_well(report):
    """Its worker lives, answers probes, says what it runs, and is ready."""
    _, checks = report
    assert checks["service", "workers"]["found"] == "worker"
    assert "round trip" in checks["service", "way to worker"]["found"]
    assert checks["service", "/livez"]["finding"] == "ok"
    assert checks["service", "/readyz"]["finding"] == "ok"
    assert "model" in checks["service", "worker worker"]["found"]


def test_the_vehicle_is_heard(report):
    """Mode, rate, attitude and clock of the PX4-like process."""
    _, checks = report
    assert "POSCTL" in checks["vehicle", "heartbeat"]["found"]
    assert checks["vehicle", "attitude"]["finding"] == "ok"
    assert float(checks["vehicle", "pose rate"]["found"].split()[0]) > 5
    assert ("vehicle", "time sync") in checks


def test_parameters_are_compared(report):
    """What the process answers is beside what is packaged; what it does not know is told."""
    code, checks = report
    named = {name: c for (area, name), c in checks.items() if area == "vehicle" and name.isupper()}
    wrong = [c for c in named.values() if c["finding"] == "fault"]
    assert all(c["advice"].startswith("set it to ") for c in wrong)
    assert ("vehicle", "parameters") in checks
    faults = [c for c in checks.values() if c["finding"] == "fault"]
    assert code == (1 if faults else 0)


def test_a_worker_that_is_not_there(tmp_path):
    """Told with how far a knock came, and nothing hangs."""
    code, checks = examined("--connect", "tcp/127.0.0.1:1", "--wait-s", "0.2")
    assert code == 1
    assert "Connection refused" in checks["service", "workers"]["advice"]
