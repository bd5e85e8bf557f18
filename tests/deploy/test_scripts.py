"""The shell scripts: help that changes nothing, and one environment that is set up once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from tests.deploy.manifests import ROOT

FAKE_PYTHON = """\
#!/bin/sh
echo start >>"$LOG"
sleep 0.2
echo end >>"$LOG"
"""
"""Stands where pip would run; two at once would mix their lines."""
SCRIPT = """\
source "$(dirname "$0")/setup.sh"
help_of "$@"
prepare dev
"""


@pytest.fixture
def project(tmp_path):
    """A project of the set-up alone, with an environment whose interpreter only says it ran."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / ".venv/bin").mkdir(parents=True)
    (tmp_path / "pyproject.toml").touch()
    shutil.copy(ROOT / "scripts/setup.sh", tmp_path / "scripts")
    (tmp_path / "scripts/go").write_text(f"#!/usr/bin/env bash\n# What it is for.\n{SCRIPT}")
    python = tmp_path / ".venv/bin/python"
    python.write_text(FAKE_PYTHON)
    python.chmod(0o755)
    return tmp_path


def go(project, *arguments):
    """The project's script as a process."""
    env = os.environ | {"PYTHON": sys.executable, "LOG": str(project / "log")}
    return subprocess.Popen(
        ["bash", project / "scripts/go", *arguments],
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("name", ["bench", "check", "demo", "figures", "test"])
def test_every_script_has_a_help_that_names_it(name):
    """It ends at once, whatever is installed."""
    done = subprocess.run(
        [ROOT / "scripts" / name, "--help"], capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert f"scripts/{name}" in done.stdout
    assert "#" not in done.stdout


def test_help_sets_nothing_up(project):
    """The script's own first comment, and no environment."""
    process = go(project, "--help")
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (0, "What it is for.\n", "")
    assert not (project / "log").exists()


@pytest.mark.skipif(shutil.which("flock") is None, reason="needs flock")
def test_two_scripts_at_once_set_up_one_after_the_other_and_once(project):
    """Two pips in one environment break it."""
    both = [go(project), go(project)]
    for process in both:
        _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
    lines = (project / "log").read_text().split()
    assert lines == ["start", "end"] * 2  # torch, then the project: of one script alone
