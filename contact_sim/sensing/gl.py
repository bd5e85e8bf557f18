"""Which OpenGL draws without a screen: found once, before mujoco loads any.

Importing this imports no mujoco, which reads MUJOCO_GL as it loads, and fails by it.
"""

from __future__ import annotations

import functools
import importlib
import os
import subprocess
import sys
from typing import Any

from contact_sim.errors import RenderError

OFFSCREEN = ("egl", "osmesa")
"""What is tried, in this order."""
_MODULES = {"egl": "mujoco.egl", "osmesa": "mujoco.osmesa", "glfw": "mujoco.glfw"}
_INSTALL = (
    "install libegl1 and libegl-mesa0 for EGL, or libosmesa6 for OSMesa (Debian's and Ubuntu's "
    "names), or set MUJOCO_GL to one that works"
)
_TRIAL = """
import mujoco
from {module} import GLContext
context = GLContext(64, 64)
context.make_current()
model = mujoco.MjModel.from_xml_string("<mujoco/>")
mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
"""
_TRIAL_S = 60.0
_PLATFORM = "PYOPENGL_PLATFORM"


def open_context(width: int, height: int) -> Any:
    """A GL context of mujoco's that needs no screen.

    Raises:
        RenderError: none works here; says what to install.
    """
    name = choose_gl()
    try:
        return importlib.import_module(_MODULES[name]).GLContext(width, height)
    # what worked when it was tried is told all the same where it does not any more
    except (RuntimeError, AttributeError, ImportError, OSError) as error:
        raise RenderError(f"no OpenGL draws: {name} ({_short(error)}); {_INSTALL}") from None


def load_mujoco() -> None:
    """Import mujoco, in whose name MUJOCO_GL may hold what breaks the import.

    Where nothing is drawn this is all that has to be looked at; what draws asks ``choose_gl``
    first.

    Raises:
        RenderError: it cannot be imported with that; says what may be set, and what to install.
        ModuleNotFoundError: it is not installed.
    """
    try:
        importlib.import_module("mujoco")
    except ModuleNotFoundError:
        raise
    # by what is set it is an unknown word, a library without its functions, a driver that is not
    except (RuntimeError, AttributeError, ImportError, OSError) as error:
        wanted = os.environ.get("MUJOCO_GL", "")
        raise RenderError(
            f"mujoco cannot be loaded with MUJOCO_GL = {wanted!r} ({_short(error)}): leave it "
            f"unset, or set it to one of {', '.join(_MODULES)}; {_INSTALL}"
        ) from None


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__


@functools.cache
def choose_gl() -> str:
    """The name of the OpenGL that works; MUJOCO_GL is set to it, and wins where a user set it.

    Raises:
        RenderError: none works; says why of each, and what to install.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted and wanted not in _MODULES:
        raise RenderError(f"MUJOCO_GL = {wanted!r} is none of {', '.join(_MODULES)}; {_INSTALL}")
    failures = []
    for name in (wanted,) if wanted else OFFSCREEN:
        failure = _failure_of(name)
        if not failure:
            os.environ["MUJOCO_GL"] = name  # libmujoco reads it when it loads its GL
            os.environ.pop(_PLATFORM, None)  # mujoco sets it, and breaks by another one
            return name
        failures.append(f"{name} ({failure})")
    asked = "as MUJOCO_GL asks" if wanted else "without a screen"
    raise RenderError(f"no OpenGL draws {asked}: {'; '.join(failures)}; {_INSTALL}")


def _failure_of(name: str) -> str:
    """Why one of them does not draw; empty: it does.

    Tried in a process of its own: one that fails leaves its half-loaded library behind, and then
    the next cannot be tried any more.
    """
    environment = {k: v for k, v in os.environ.items() if k != _PLATFORM}
    environment["MUJOCO_GL"] = name
    trial = [sys.executable, "-c", _TRIAL.format(module=_MODULES[name])]
    try:
        done = subprocess.run(
            trial, env=environment, capture_output=True, text=True, timeout=_TRIAL_S, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {_TRIAL_S:g} s"
    if done.returncode == 0:
        return ""
    said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    errors = [line for line in said if "Error" in line and not line.startswith("Exception ign")]
    return (errors or said or [f"exit status {done.returncode}"])[-1][:160]
