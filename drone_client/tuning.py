"""Numbers of mission, guidance, safety filter and odometry from a TOML file; others stay."""

from __future__ import annotations

import tomllib
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from drone_client.control import ControlSettings
from drone_client.errors import TuningError
from drone_client.flight_settings import FlightSettings

MAX_TUNING_BYTES = 65_536
ODOMETRY = "odometry"
"""The one table that is not of ``ControlSettings``."""

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


def load_tuning(path: Path, parts: FlightSettings) -> FlightSettings:
    """The parts of a flight with the numbers of a file in their place.

    Its tables are ``[mission]``, ``[mission.contact]``, ``[guidance]``, ``[filter]`` and so on, as
    ``ControlSettings`` is nested, and ``[odometry.budget]`` and so on, as ``OdometrySettings`` is;
    every number is bounded where it is at home.

    Raises:
        TuningError: with the path, the field at fault and what it may be.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_TUNING_BYTES + 1)
        if len(data) > MAX_TUNING_BYTES:
            raise TuningError(f"over {MAX_TUNING_BYTES} bytes")
        table = tomllib.loads(data.decode("utf-8"))
        odometry = _nested(parts.odometry, table.pop(ODOMETRY, {}), ODOMETRY)
        control = _with(parts.control, table, "", beside=(ODOMETRY,))
        drift_mps, covered_mps = odometry.budget.drift_mps, control.filter.drift_mps
        if drift_mps > covered_mps:
            raise TuningError(
                f"odometry.budget.drift_mps = {drift_mps:g} exceeds filter.drift_mps = "
                f"{covered_mps:g}: the error ball would not cover it; change both"
            )
        _check_twins(control)
        return replace(parts, control=control, odometry=odometry)
    except OSError as error:
        raise TuningError(f"tuning file {path}: {error.strerror}") from None
    except (ValueError, RecursionError, TuningError) as error:
        raise TuningError(f"tuning file {path}: {error}") from None


def _check_twins(control: ControlSettings) -> None:
    """Numbers that two parts of the control need, each in its own table."""
    at_m, blind_at_m = control.mission.standoff_m, control.filter.standoff_m
    if at_m != blind_at_m:
        raise TuningError(
            f"mission.standoff_m = {at_m:g} and filter.standoff_m = {blind_at_m:g}: the mission's "
            "retreat and the filter's own end in one place; change both"
        )
    lag_s, covered_s = control.guidance.lag_s, control.filter.lag_s
    if lag_s > covered_s:
        raise TuningError(
            f"guidance.lag_s = {lag_s:g} exceeds filter.lag_s = {covered_s:g}: the filter would "
            "brake for a quicker vehicle than the guidance flies; change both"
        )


def _nested(settings: Any, table: object, name: str) -> Any:
    if not isinstance(table, dict):
        raise TuningError(f"{name} must be a table [{name}]")
    return _with(settings, table, f"{name}.")


def _with(settings: Any, table: dict[str, Any], where: str, beside: tuple[str, ...] = ()) -> Any:
    """The settings with a table's values; ``beside``: what else may stand there."""
    known = {field.name for field in fields(settings) if field.init}
    changes: dict[str, Any] = {}
    for key, value in table.items():
        name = f"{where}{key}"
        if key not in known or name in NOT_FROM_A_FILE:
            may = sorted({*beside, *(k for k in known if f"{where}{k}" not in NOT_FROM_A_FILE)})
            raise TuningError(f"unknown {name[:80]!r}; known: {', '.join(may)}")
        now = getattr(settings, key)
        if is_dataclass(now):
            changes[key] = _nested(now, value, name)
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
        with suppress(OverflowError):  # of a whole number without end
            return float(value)
    wanted = {bool: "true or false", int: "a whole number", float: "a number"}
    raise TuningError(f"{name} = {value!r:.40} must be {wanted.get(type(now), 'left alone')}")
