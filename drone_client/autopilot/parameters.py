"""Parameter files in QGroundControl's format, and those that come with the project.

A line is ``system<TAB>component<TAB>name<TAB>value<TAB>type``; lines with # are comments. The
comment above a line says why the value is so, and is kept: whoever compares shows it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from pymavlink.dialects.v20 import common as mav

from drone_client.errors import AutopilotError

PACKAGED = "aerial-contact.params"
"""PX4's."""
FILE_MAX_BYTES = 1_000_000
_REAL = mav.MAV_PARAM_TYPE_REAL32
_TYPES = range(mav.MAV_PARAM_TYPE_UINT8, _REAL + 1)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One wanted value."""

    name: str
    value: float | int
    why: str
    """The comment above it, on one line."""

    def matches(self, value: float | int) -> bool:
        """Whether the autopilot's value is the wanted one: MAVLink's floats have 24 bits."""
        return math.isclose(self.value, value, rel_tol=1e-6, abs_tol=1e-9)


def packaged_parameters(name: str = PACKAGED) -> dict[str, Parameter]:
    """The parameters that an autopilot needs for this project, by name.

    Args:
        name: of the flavour's file.
    """
    text = files("drone_client.autopilot").joinpath(name).read_text(encoding="utf-8")
    return parse_parameters(text, name)


def load_parameter_file(path: Path) -> dict[str, Parameter]:
    """The parameters of a file, by name.

    Raises:
        AutopilotError: the file cannot be read, or a line of it is none of a parameter file.
    """
    try:
        if path.stat().st_size > FILE_MAX_BYTES:
            raise AutopilotError(f"{path}: too large for a parameter file")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AutopilotError(f"{path}: cannot be read as a parameter file ({error})") from None
    return parse_parameters(text, str(path))


def parse_parameters(text: str, source: str) -> dict[str, Parameter]:
    """The parameters of a text, by name.

    Raises:
        AutopilotError: names the line and what is wrong with it.
    """
    found: dict[str, Parameter] = {}
    why: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        stripped = line.strip()
        if stripped.startswith("#"):
            why.append(stripped.lstrip("# ").strip())
        elif not stripped:
            why.clear()
        else:
            parameter = _parse_line(line, f"{source}, line {number}", " ".join(why))
            if parameter.name in found:
                raise AutopilotError(f"{source}, line {number}: {parameter.name} is there twice")
            found[parameter.name] = parameter
            why.clear()
    if not found:
        raise AutopilotError(f"{source}: no parameter in it")
    return found


def _parse_line(line: str, where: str, why: str) -> Parameter:
    fields = line.rstrip("\r\n").split("\t")
    if len(fields) != 5:
        raise AutopilotError(
            f"{where}: {len(fields)} fields, expected 5 with tabs between them: system, component, "
            "name, value, type"
        )
    name = fields[2].strip()
    if not 0 < len(name) <= 16 or not name.isascii():
        raise AutopilotError(f"{where}: {name[:40]!r} is no name of a parameter")
    try:
        value, kind = float(fields[3]), int(fields[4])
    except ValueError:
        raise AutopilotError(
            f"{where}: value {fields[3][:40]!r} or type {fields[4][:40]!r} is no number"
        ) from None
    if not math.isfinite(value) or kind not in _TYPES:
        raise AutopilotError(f"{where}: {name} = {value} of type {kind} cannot be")
    if kind != _REAL and not value.is_integer():
        raise AutopilotError(f"{where}: {name} = {value:g} is of a whole type")
    return Parameter(name, value if kind == _REAL else int(value), why)
