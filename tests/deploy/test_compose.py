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
from tests.deploy.manifests import ROOT, compose_with_defaults


def schema_errors(file: Path) -> str:
    """What the compose specification's own schema says against a file; empty: nothing."""
    tool = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    result = subprocess.run([*tool, str(file)], capture_output=True, text=True, check=False)
    return "" if result.returncode == 0 else result.stdout + result.stderr


@pytest.fixture
def services():
    """The services, with variables at their defaults."""
    return compose_with_defaults()["services"]


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


def test_the_file_is_valid():
    """It passes the schema of the compose specification."""
    assert schema_errors(ROOT / "compose.yaml") == ""


def test_the_schema_sees_a_wrong_field(tmp_path):
    """The check above can fail: a misspelt field is refused."""
    compose = compose_with_defaults()
    compose["services"]["worker"]["read-only"] = True
    file = tmp_path / "compose.yaml"
    file.write_text(yaml.safe_dump(compose), encoding="utf-8")
    assert "'read-only' was unexpected" in schema_errors(file)


@pytest.mark.parametrize("name", ["worker", "drone"])
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


def test_ports_are_open_to_this_machine_alone(services):
    """Each published port is bound to the loopback address."""
    assert len(services["worker"]["ports"]) == 2
    assert all(port.startswith("127.0.0.1:") for port in services["worker"]["ports"])
    assert "ports" not in services["drone"]


def test_the_worker_accepts_its_settings(services, environment):
    """The service takes every variable and listens where the published ports lead."""
    environment("worker")
    settings = load_edge_settings()
    targets = [int(port.rpartition(":")[2]) for port in services["worker"]["ports"]]
    assert settings.listen_endpoints == (f"tcp/0.0.0.0:{targets[0]}",)
    assert settings.http_address == ("0.0.0.0", targets[1])


def test_the_drone_flies_against_the_worker(services, environment):
    """The client takes every variable, connects to the worker's port and waits long enough."""
    environment("drone")
    drone = load_drone_settings()
    environment("worker")
    port = load_edge_settings().listen_endpoints[0].rpartition(":")[2]
    assert drone.endpoints == (f"tcp/worker:{port}",)
    assert drone.wait_for_worker_s >= 60


def test_the_drone_replays_what_ships_with_the_project(services):
    """Its command line parses, and names a recording of the repository and a mounted folder."""
    command = services["drone"]["command"]
    group = typer.main.get_command(drone_app)
    assert command[0] == "drone-client"
    context = group.commands[command[1]].make_context(command[1], list(command[2:]))
    assert (ROOT / context.params["folder"] / "camera.json").is_file()
    assert (ROOT / context.params["truth"]).is_file()
    assert services["drone"]["volumes"] == [f"runs:{context.params['out']}"]


def test_a_replay_ends(services):
    """The drone is not started again when it is done, and its exit code can be asked for."""
    assert services["drone"]["restart"] == "no"
