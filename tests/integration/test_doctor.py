"""The doctor beside real ends: service, PX4-like peer with a wrong parameter, ROS 2, TLS."""

from __future__ import annotations

import json
import re
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drone_client.cli import app
from drone_client.ros.names import ODOMETRY, RANGE, Flavour, key
from tests.certificates import make_ending, make_ends
from tests.integration.px4_process import PeerProcess
from tests.service_process import free_port, free_udp_port, service_process
from tests.unit.drone_client.builders import SECOND, pose
from tests.unit.drone_client.ros_robot import Robot, odometry_cdr, range_cdr

ROOT = Path(__file__).parents[2]
FLOOR_M = 1.55
"""What the lidar measures; the PX4-like peer believes in 1.5."""


def examined(*arguments: str) -> tuple[int, dict[tuple[str, str], dict]]:
    """Exit code, and the checks by area and name."""
    command = [str(Path(sys.executable).with_name("drone-client")), "doctor", "--json", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stderr == ""
    checks = json.loads(done.stdout)["checks"]
    named = {(c["area"], c["name"]): c for c in checks}
    assert len(named) == len(checks), "no two rows of one name"
    return done.returncode, named


@contextmanager
def robot(endpoint: str, hop_m: float = 0.0) -> Iterator[None]:
    """VIO, which hops there or back every second, and a lidar that looks down; both at 50 Hz."""
    over, ros = threading.Event(), Robot(endpoint)

    def publish() -> None:
        while not over.wait(0.02):
            now_ns = time.time_ns()
            vio = odometry_cdr(
                unix_ns=now_ns,
                body=pose((now_ns // SECOND % 2 * hop_m, 0, FLOOR_M)),
                velocity=np.zeros(3),
            )
            ros.put(key(Flavour.BRIDGE, "vio", ODOMETRY, 0), vio)
            ros.put(
                key(Flavour.BRIDGE, "lidar", RANGE, 0), range_cdr(unix_ns=now_ns, distance=FLOOR_M)
            )

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        ros.zenoh.close()


@contextmanager
def server(serve: Callable[[socket.socket], None]) -> Iterator[int]:
    """A TCP port whose connections are served one after the other."""
    over = threading.Event()

    def run() -> None:
        while not over.is_set():
            try:
                connection, _ = listening.accept()
            except TimeoutError:
                continue
            with connection:
                try:
                    serve(connection)
                except OSError:  # it has left
                    continue

    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(0.1)
        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield listening.getsockname()[1]
        finally:
            over.set()
            thread.join()


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """One look at everything that can be there without a drone."""
    folder = tmp_path_factory.mktemp("doctor")
    port = free_udp_port()
    ros = f"tcp/127.0.0.1:{free_port()}"
    peer = PeerProcess("--udp", f"127.0.0.1:{port}")
    try:
        with service_process(folder) as service, robot(ros):
            return examined(
                "--autopilot",
                f"udp/127.0.0.1:{port}",
                "--airframe",
                str(ROOT / "examples" / "airframe.toml"),
                "--connect",
                service.endpoint,
                "--url",
                f"http://{service.http}",
                "--onboard-fallback",
                "--onboard-target",
                "bullseye-200",
                "--ros-connect",
                ros,
                "--vio-topic",
                "vio",
                "--lidar-topic",
                "lidar",
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


def test_an_armed_vehicle_is_a_warning(report):
    """The process is armed, and in the air."""
    _, checks = report
    arming = checks["vehicle", "arming"]
    assert (arming["finding"], arming["found"]) == ("warning", "armed, in the air")


def test_a_wrong_parameter_is_a_fault_and_a_silent_one_is_named(report):
    """The process has height from GNSS, and knows three of the packaged parameters at all."""
    code, checks = report
    assert code == 1
    height = checks["vehicle", "EKF2_HGT_REF"]
    assert (height["finding"], height["found"]) == ("fault", "1")
    assert height["advice"].startswith("set it to 2: ")
    others = [n for a, n in checks if a == "vehicle" and n.isupper() and n != "EKF2_HGT_REF"]
    assert others == []
    parameters = checks["vehicle", "parameters"]
    assert parameters["finding"] == "fault"
    assert "1 otherwise, no answer for " in parameters["found"]
    assert "COM_RC_OVERRIDE" in parameters["found"]


def test_the_robots_own_sensors_are_heard(report):
    """Rate, age and jumps of the VIO, and the lidar held against the autopilot's height."""
    _, checks = report
    assert float(checks["odometry", "VIO rate"]["found"].split()[0]) > 5
    assert checks["odometry", "messages"]["finding"] == "ok"
    assert "VIO jumps" in {name for _, name in checks}
    assert checks["odometry", "lidar down distance"]["found"].startswith("1.55 m")
    height = checks["vehicle", "height"]
    assert height["finding"] == "ok"
    assert height["found"] == "1.50 m by the estimate, 1.55 m by the lidar"


def test_a_vio_that_jumps_is_a_fault_unless_it_is_tuned_not_to_be(tmp_path):
    """With how far it was and how far it can be."""
    ros = f"tcp/127.0.0.1:{free_port()}"
    bold = tmp_path / "tuning.toml"
    bold.write_text("[odometry.vio_jump]\nposition_m = 0.5\nslide_m = 0.5\ngap_ns = 2000000000")
    with robot(ros, hop_m=0.2):
        nobody = ("--connect", "tcp/127.0.0.1:1", "--wait-s", "0.1")
        heard = ("--ros-connect", ros, "--vio-topic", "vio", *nobody)
        _, checks = examined(*heard)
        _, tuned = examined(*heard, "--tuning", str(bold))
    jumps = checks["odometry", "VIO jumps"]
    assert jumps["finding"] == "fault"
    assert re.search(r"jumped \((position|gap)\)", jumps["found"])  # a gap on a busy machine
    assert tuned["odometry", "VIO jumps"]["finding"] == "ok"
    assert tuned["files", "tuning"]["finding"] == "ok"


def test_two_targets_are_a_fault(report):
    """The service looks for its default, the drone's own eyes for the small one."""
    _, checks = report
    assert checks["service", "target"]["finding"] == "fault"
    assert "bullseye-400" in checks["service", "target"]["found"]
    assert checks["files", "target"]["finding"] == "ok"


def test_a_worker_that_is_not_there(tmp_path):
    """Told with how far a knock came, and nothing hangs."""
    code, checks = examined("--connect", "tcp/127.0.0.1:1", "--wait-s", "0.2")
    assert code == 1
    assert "Connection refused" in checks["service", "workers"]["advice"]


def test_an_expired_certificate_is_named(tmp_path):
    """With its file and its day, and the service is not blamed for it."""
    ends = make_ends(tmp_path / "ends")
    ended = make_ending(ends, "drone-1", timedelta(days=-1))
    code, checks = examined(
        "--name", "drone-1", "--tls", str(ended), "--connect", "tls/localhost:1"
    )
    assert code == 1
    certificates = checks["files", "certificates"]
    assert certificates["finding"] == "fault"
    assert f"{ended / 'cert.pem'} expired on " in certificates["found"]
    assert "expired on" in checks["service", "service"]["found"]


def test_a_tls_endpoint_is_knocked_at_with_our_certificate(tmp_path):
    """A worker of our authority that takes it but does not live is not called untrustworthy."""
    ends = make_ends(tmp_path / "ends")
    context = ssl.create_default_context(
        ssl.Purpose.CLIENT_AUTH, cafile=str(ends / "worker-a/ca.pem")
    )
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_cert_chain(ends / "worker-a/cert.pem", ends / "worker-a/key.pem")

    def shake_hands(connection: socket.socket) -> None:
        connection.settimeout(5.0)
        with context.wrap_socket(connection, server_side=True) as secured:
            secured.recv(1)

    with server(shake_hands) as port:
        endpoint = ("--connect", f"tls/localhost:{port}", "--wait-s", "0.2")
        code, checks = examined("--name", "drone-1", "--tls", str(ends / "drone-1"), *endpoint)
    assert code == 1
    assert "it takes our certificate" in checks["service", "workers"]["advice"]


def test_a_service_that_answers_a_byte_now_and_then_does_not_keep_it(tmp_path):
    """No read of it ever times out; the area is at fault, the others are told, and it ends."""
    over = threading.Event()

    def drip(connection: socket.socket) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n")
        while not over.wait(0.2):
            connection.sendall(b" ")

    with server(drip) as port:
        try:
            code, checks = examined(
                "--url", f"http://127.0.0.1:{port}", "--limit-s", "2", "--wait-s", "0.1"
            )
        finally:
            over.set()
    assert code == 1
    assert checks["service", "service"]["finding"] == "fault"
    assert checks["service", "service"]["found"] == "no end within 2.1 s"
    assert ("machine", "clock") in checks


@pytest.mark.parametrize(
    ("kernel", "endpoint", "told"),
    [
        ("cubic", "tcp/192.0.2.7:1", True),
        ("bbr", "tcp/192.0.2.7:1", False),
        ("cubic", "tcp/127.0.0.1:1", False),
    ],
)
def test_a_congestion_control_that_a_radio_does_not_bear(
    kernel, endpoint, told, tmp_path, monkeypatch
):
    """A warning, of a way that leaves this machine alone."""
    file = tmp_path / "tcp_congestion_control"
    file.write_text(f"{kernel}\n")
    monkeypatch.setattr("drone_client.link.zenoh.CONGESTION_CONTROL_FILE", file)
    options = ["--connect", endpoint, "--wait-s", "0.1", "--json", "--out", str(tmp_path / "RUN")]
    result = CliRunner().invoke(app, ["doctor", *options])
    links = [c for c in json.loads(result.stdout)["checks"] if c["name"] == "link"]
    assert [c["finding"] for c in links] == ["warning"] * told
    assert all(repr(kernel) in c["found"] for c in links)
