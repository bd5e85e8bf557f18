"""Numbers of mission, guidance and safety filter from a TOML file; others keep their value."""

from __future__ import annotations

import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from drone_client.control import ControlSettings
from drone_client.errors import TuningError

MAX_TUNING_BYTES = 65_536

NOT_FROM_A_FILE = frozenset(
    {
        "keep_outs",
        "filter.variant",
        "filter.allow_unsafe_variant",
        "filter.period_s",
        "filter.age_max_ns",
        "filter.unconfirmed_mps",
        "mission.needs_vehicle",
    }
)
"""Set by the command line and its flags alone, or by nobody in flight."""


def load_tuning(path: Path, settings: ControlSettings) -> ControlSettings:
    """Settings with the numbers of a file in their place.

    Its tables are ``[mission]``, ``[mission.contact]``, ``[guidance]``, ``[filter]`` and so on, as
    the settings are nested; every number is bounded where it is at home.

    Raises:
        TuningError: with the path, the field at fault and what it may be.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_TUNING_BYTES + 1)
        if len(data) > MAX_TUNING_BYTES:
            raise TuningError(f"over {MAX_TUNING_BYTES} bytes")
        tuned: ControlSettings = _with(settings, tomllib.loads(data.decode("utf-8")), "")
        return tuned
    except OSError as error:
        raise TuningError(f"tuning file {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, TuningError) as error:
        raise TuningError(f"tuning file {path}: {error}") from None


def _with(settings: Any, table: dict[str, Any], where: str) -> Any:
    known = {field.name for field in fields(settings) if field.init}
    changes: dict[str, Any] = {}
    for key, value in table.items():
        name = f"{where}{key}"
        if key not in known or name in NOT_FROM_A_FILE:
            may = sorted(k for k in known if f"{where}{k}" not in NOT_FROM_A_FILE)
            raise TuningError(f"unknown {name[:80]!r}; known: {', '.join(may)}")
        now = getattr(settings, key)
        if is_dataclass(now):
            if not isinstance(value, dict):
                raise TuningError(f"{name} must be a table [{name}]")
            changes[key] = _with(now, value, f"{name}.")
        else:
            changes[key] = _like(now, value, name)
    try:
        return replace(settings, **changes)
    except (ValueError, TypeError) as error:
        raise TuningError(str(error)) from None


def _like(now: object, value: object, name: str) -> object:
    """A value of the kind that it replaces."""
    if isinstance(now, bool) or isinstance(value, bool):
        if isinstance(now, bool) and isinstance(value, bool):
            return value
    elif isinstance(now, int) and isinstance(value, int):
        return value
    elif isinstance(now, float) and isinstance(value, int | float):
        return float(value)
    wanted = {bool: "true or false", int: "a whole number", float: "a number"}
    raise TuningError(f"{name} = {value!r:.40} must be {wanted.get(type(now), 'left alone')}")
