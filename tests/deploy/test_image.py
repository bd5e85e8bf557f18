"""The Dockerfile lints clean, and what it says twice it says the same."""

from __future__ import annotations

import http.server
import json
import re
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import pytest

from tests.deploy.manifests import ROOT, compose_with_defaults, dockerfile

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
BIN = Path(sys.executable).parent


def arguments() -> dict[str, str]:
    """Build arguments with their defaults."""
    pairs = (rest.partition("=") for name, rest in dockerfile() if name == "ARG")
    return {name: default for name, _, default in pairs}


def health_commands() -> list[list[str]]:
    """The health checks of the image and of the compose file, as they are executed."""
    (image,) = [rest for name, rest in dockerfile() if name == "HEALTHCHECK"]
    compose = compose_with_defaults()["services"]["worker-a"]["healthcheck"]["test"]
    return [json.loads(image.partition("CMD ")[2]), compose[1:]]


def test_the_dockerfile_lints_clean():
    """Hadolint has nothing to say, not even about style."""
    command = [BIN / "hadolint", "--failure-threshold", "style", "Dockerfile"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (0, "")


def test_the_yaml_lints_clean():
    """Yamllint has nothing to say about any file of the deployment."""
    command = [
        BIN / "yamllint",
        "--strict",
        "compose.yaml",
        "compose.secure.yaml",
        "deploy",
        ".yamllint.yaml",
    ]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (0, "")


def test_versions_are_those_of_the_project():
    """Torch and the version label are what pyproject.toml says."""
    edge = PROJECT["project"]["optional-dependencies"]["edge"]
    assert f"torch=={arguments()['TORCH_VERSION']}" in edge
    assert arguments()["VERSION"] == PROJECT["project"]["version"]


def test_the_base_image_and_the_index_can_be_chosen():
    """Every stage stands on BASE_IMAGE or another stage, and no default names a registry's host."""
    sources = [rest.split() for name, rest in dockerfile() if name == "FROM"]
    stages = {s[2] for s in sources if len(s) == 3}
    assert {s[0] for s in sources} - stages == {"${BASE_IMAGE}"}
    assert "/" not in arguments()["BASE_IMAGE"]
    assert arguments()["TORCH_INDEX_URL"] == ""


def test_the_image_does_not_run_as_root():
    """The last word on the user is uid 10001; the default command is the service."""
    users = [rest for name, rest in dockerfile() if name == "USER"]
    assert users[-1] == "10001:10001"
    commands = [rest for name, rest in dockerfile() if name == "CMD"]
    assert [json.loads(c) for c in commands] == [["edge-service", "serve"]]
    assert "ENTRYPOINT" not in {name for name, _ in dockerfile()}


def test_runs_can_be_written_by_any_user():
    """The user is chosen by who may read the keys: the folder for the results takes all of them."""
    (made,) = [rest for name, rest in dockerfile() if name == "RUN" and rest.endswith(" /runs")]
    assert "--mode=1777" in made


def test_the_image_holds_every_package_that_a_role_needs():
    """What is copied exists, passes .dockerignore and covers the packages of both roles."""
    copied = {
        source
        for name, rest in dockerfile()
        if name == "COPY" and not rest.startswith("--from")
        for source in rest.split()[:-1]
    }
    ignore = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    passed = {line[1:] for line in ignore if line.startswith("!")}
    assert copied == passed
    assert all((ROOT / source).exists() for source in copied)
    found = PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
    packages = {name.rstrip("*") for name in found}
    assert packages - copied == {"contact_sim", "detector_training", "link_emulator"}


def test_the_ports_are_those_of_both_links_and_of_http():
    """What the image says that it listens on."""
    (exposed,) = [rest.split() for name, rest in dockerfile() if name == "EXPOSE"]
    assert exposed == ["7447/tcp", "7448/udp", "8080/tcp"]


@pytest.mark.parametrize("command", health_commands())
@pytest.mark.parametrize(("status", "healthy"), [(200, True), (503, False)])
def test_a_health_check_tells_well_from_ill(command, status, healthy):
    """Each health check succeeds on 200 and fails on 503, without a proxy in between."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(status if self.path in ("/livez", "/readyz") else 404)
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        code = re.sub(r":8080/", f":{server.server_port}/", command[-1])
        assert command[:2] == ["python", "-c"]
        assert code != command[-1]
        environment = {"http_proxy": "http://127.0.0.1:9", "PATH": ""}
        result = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, check=False
        )
        server.shutdown()
        thread.join()
    assert (result.returncode == 0) is healthy
