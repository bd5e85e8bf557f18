"""What a simulated flight needs is looked for before anything starts, and told in one line.

The commands run as a user runs them: MUJOCO_GL is read as mujoco loads, once in a process.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.flight_process import FLY, SIMULATOR

AIRFRAME = Path(__file__).parents[2] / "examples" / "airframe.toml"


def without_gl(folder: Path) -> dict[str, str]:
    """Variables under which no library here draws."""
    for name in ("libOSMesa.so", "libOSMesa.so.6", "libOSMesa.so.8"):
        (folder / name).write_bytes(b"")  # found first, and no library
    return {
        "LD_LIBRARY_PATH": str(folder),
        "__EGL_VENDOR_LIBRARY_FILENAMES": str(folder / "none.json"),  # no driver
    }


def refused(variables: dict[str, str], *command: str) -> str:
    """The one line that it says at last; its exit code is 2, and nothing is a traceback."""
    env = {k: v for k, v in os.environ.items() if k != "MUJOCO_GL"} | variables
    done = subprocess.run(
        command, env=env, capture_output=True, text=True, timeout=240, check=False
    )
    lines = done.stderr.splitlines()
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert all(line.startswith("building the world") for line in lines[:-1]), lines
    return lines[-1]


@pytest.mark.parametrize("setting", ["bogus", "egl", "osmesa"])
def test_a_flight_is_refused_with_a_wrong_mujoco_gl(setting: str, tmp_path: Path):
    """A word that is none, and a library that is not there or does not draw."""
    out = tmp_path / "run"
    variables = without_gl(tmp_path) | {"MUJOCO_GL": setting}
    line = refused(variables, *FLY, "--sim", "tunnel", "--out", str(out))
    assert "MUJOCO_GL" in line
    assert "libegl1" in line
    assert not out.exists()


@pytest.mark.parametrize("command", ["campaign", "hil", "film"])
def test_a_word_that_mujoco_does_not_know_is_told(command: str):
    """Before anything is flown, also where nothing would be drawn."""
    line = refused({"MUJOCO_GL": "bogus"}, *SIMULATOR, command)
    assert line.startswith("contact_sim: mujoco cannot be loaded with MUJOCO_GL = 'bogus'")
    assert "one of egl, osmesa, glfw" in line


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize("setting", ["egl", "osmesa"])
def test_a_library_that_is_not_there_is_no_traceback(setting: str, hidden: bool, tmp_path: Path):
    """How mujoco fails by it depends on the machine: it is loaded, or that is told in a line."""
    variables = {"MUJOCO_GL": setting} | (without_gl(tmp_path) if hidden else {})
    done = subprocess.run(
        [*SIMULATOR, "hil", "--help"],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode in (0, 2)
    lines = done.stderr.splitlines()
    assert lines == [] if done.returncode == 0 else len(lines) == 1


def test_without_opengl_nothing_is_started(tmp_path: Path):
    """Neither service nor vehicle; it says what to install."""
    out = tmp_path / "run"
    line = refused(without_gl(tmp_path), *FLY, "--sim", "tunnel", "--out", str(out))
    assert line.startswith("drone-client: no OpenGL draws without a screen: egl (")
    assert "install libegl1 and libegl-mesa0" in line
    assert not out.exists()


def test_an_airframe_that_cannot_be_simulated_is_refused(tmp_path: Path):
    """The client would take it; the world has no such drone."""
    file, out = tmp_path / "long.toml", tmp_path / "run"
    text = AIRFRAME.read_text().replace(
        "translation_m = [0.55, 0.0, 0.0]", "translation_m = [2.9, 0.0, 0.0]"
    )
    file.write_text(text)
    line = refused({}, *FLY, "--sim", "tunnel", "--airframe", str(file), "--out", str(out))
    assert "an arm that reaches 2.90 m has no room where the flight begins" in line
    assert not out.exists()
