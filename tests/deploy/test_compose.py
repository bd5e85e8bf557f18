"""The compose file is valid, hardened, and fits the commands that it runs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main
import yaml

from drone_client.cli import app as drone_app
from drone_client.settings import ENV_PREFIX as DRONE_PREFIX
from drone_client.settings import load_settings as load_drone_settings
from edge_service.settings import PREFIX as EDGE_PREFIX
from edge_service.settings import load_settings as load_edge_settings
from tests.certificates import make_ends
from tests.deploy.manifests import ROOT, compose_with_defaults


def schema_errors(file: Path) -> str:
    """What the compose specification's own schema says against a file; empty: nothing."""
    tool = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    result = subprocess.run([*tool, str(file)], capture_output=True, text=True, check=False)
    return "" if result.returncode == 0 else result.stdout + result.stderr


WORKERS = ("worker-a", "worker-b")
PLAIN = ("compose.yaml",)
SECURE = ("compose.yaml", "compose.secure.yaml")


@pytest.fixture(params=[PLAIN, SECURE], ids=["plain", "secure"])
def files(request):
    """The files that are given to the engine."""
    return request.param


@pytest.fixture
def services(files):
    """The services, with variables at their defaults."""
    return compose_with_defaults(*files)["services"]


@pytest.fixture
def environment(monkeypatch, services):
    """Puts a service's environment in the place of our own."""

    def use(service: str) -> None:
        prefixes = (EDGE_PREFIX, DRONE_PREFIX)
        for name in [n for n in os.environ if n.startswith(prefixes)]:
            monkeypatch.delenv(name)
        for name, value in services[service]["environment"].items():
            monkeypatch.setenv(name, value or "")

    return use


@pytest.mark.parametrize("file", SECURE)
def test_a_file_is_valid(file):
    """It passes the schema of the compose specification."""
    assert schema_errors(ROOT / file) == ""


def test_the_schema_sees_a_wrong_field(tmp_path):
    """The check above can fail: a misspelt field is refused."""
    compose = compose_with_defaults()
    compose["services"]["worker-a"]["read-only"] = True
    file = tmp_path / "compose.yaml"
    file.write_text(yaml.safe_dump(compose), encoding="utf-8")
    assert "'read-only' was unexpected" in schema_errors(file)


@pytest.mark.parametrize("name", [*WORKERS, "drone"])
def test_services_may_do_no_more_than_they_need(services, name):
    """A read-only root, no capability, no way to gain one, bounded memory and processes."""
    service = services[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["mem_limit"]
    assert service["pids_limit"]
    for key in ("privileged", "network_mode", "pid", "ipc", "cap_add", "devices"):
        assert key not in service


def test_ports_are_open_to_this_machine_alone(services, files):
    """Each published port is bound to the loopback address, and to a number of its own."""
    ports = [port for name in WORKERS for port in services[name]["ports"]]
    assert len(ports) == (6 if files == SECURE else 4)
    assert all(port.startswith("127.0.0.1:") for port in ports)
    outside = [(port.split(":")[1], port.endswith("/udp")) for port in ports]
    assert len(set(outside)) == len(ports)
    assert "ports" not in services["drone"]


@pytest.mark.parametrize("name", WORKERS)
def test_a_worker_accepts_its_settings(services, environment, files, name):
    """The service takes every variable and listens where the published ports lead."""
    environment(name)
    settings = load_edge_settings()
    assert settings.name == name
    targets = [port.rpartition(":")[2] for port in services[name]["ports"]]
    protocol = "tls" if files == SECURE else "tcp"
    assert settings.listen_endpoints == (f"{protocol}/0.0.0.0:{targets[0]}",)
    assert settings.http_address == ("0.0.0.0", int(targets[1]))
    assert [f"0.0.0.0:{t.removesuffix('/udp')}" for t in targets[2:]] == (
        [settings.udp_listen] if settings.udp_listen else []
    )


def test_the_drone_is_at_home_with_both_workers(services, environment, files):
    """The client takes every variable, connects to the workers' ports and waits long enough."""
    environment("drone")
    drone = load_drone_settings()
    environment("worker-a")
    worker = load_edge_settings()
    protocol, _, port = worker.listen_endpoints[0].replace(":", "/").split("/")
    assert drone.endpoints == tuple(f"{protocol}/{name}:{port}" for name in WORKERS)
    assert drone.wait_for_worker_s >= 60
    assert worker.drone_names == ((drone.name,) if files == SECURE else ())


def test_each_end_gets_its_own_keys_alone(tmp_path):
    """What scripts/certificates makes for these names lies where the settings look for it."""
    services = compose_with_defaults(*SECURE)["services"]
    ends = make_ends(tmp_path / "certificates", drones=("drone",), workers=WORKERS)
    for name in ("drone", *WORKERS):
        (mount,) = [v for v in services[name]["volumes"] if isinstance(v, dict)]
        assert mount["source"] == f"./certificates/{name}"
        assert mount["read_only"] is True
        assert mount["bind"]["create_host_path"] is False  # a missing folder is told, not made
        inside = {f"{mount['target']}/{p.name}" for p in (ends / name).iterdir()}
        used = services[name]["environment"]
        folder = used.get("EDGE_ZENOH_TLS") or used["DRONE_TLS"]
        keys = used.get("EDGE_TUNNEL_KEYS") or used["DRONE_KEY_FILE"]
        assert inside == {f"{folder}/{f}" for f in ("ca.pem", "cert.pem", "key.pem")} | {keys}


def test_the_drone_replays_what_ships_with_the_project(services):
    """Its command line parses, and names a recording of the repository and a mounted folder."""
    command = services["drone"]["command"]
    group = typer.main.get_command(drone_app)
    assert command[0] == "drone-client"
    context = group.commands[command[1]].make_context(command[1], list(command[2:]))
    assert (ROOT / context.params["recording"] / "camera.json").is_file()
    assert (ROOT / context.params["truth"]).is_file()
    assert services["drone"]["volumes"][0] == f"runs:{context.params['out']}"


def test_a_replay_ends(services):
    """The drone is not started again when it is done, and its exit code can be asked for."""
    assert services["drone"]["restart"] == "no"
