"""Keep-outs from a user's tables, such as those of a TOML file.

::

    [[part]]                              # a ball, or with axis_body a disc
    name = "front left propeller"
    center_body_m = [0.20, 0.20, 0.06]
    radius_m = 0.19
    axis_body = [0.0, 0.0, 1.0]

    [[keep_out]]                          # the plane of the target's board, for all parts
    name = "wall"

    [[keep_out]]
    name = "floor"
    frame = "world"
    normal = [0.0, 0.0, 1.0]
    offset_m = -0.1
    parts = ["front left propeller"]
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drone_client.cbf.keep_out import MAX_KEEP_OUTS, MAX_PARTS, BodyPart, KeepOut, PlaneFrame
from drone_client.cbf.vector import Vec3, is_bounded, norm, scaled

MAX_NAME = 40
LARGEST = 1e3
_PART = ("name", "center_body_m", "radius_m", "axis_body")
_NUMBERS = ("offset_m", "clearance_m", "uncertainty_m", "alpha")
_KEEP_OUT = ("name", "parts", "normal", "frame", *_NUMBERS)


def keep_outs_from(tables: Mapping[str, Any]) -> tuple[KeepOut, ...]:
    """The keep-outs of ``part`` and ``keep_out``; without the latter none.

    Directions may have any length. What is left out keeps ``KeepOut``'s default.

    Raises:
        ValueError: which table and which field is at fault, and what it may be.
    """
    parts: dict[str, BodyPart] = {}
    for table in _list(tables, "part", MAX_PARTS):
        name = _name(table, "part", _PART, parts)
        where = f"part {name!r}"
        axis = table.get("axis_body")
        axis = None if axis is None else _direction(axis, f"{where}: axis_body")
        center = _vector(table.get("center_body_m"), f"{where}: center_body_m")
        radius = _number(table.get("radius_m"), f"{where}: radius_m")
        try:
            parts[name] = BodyPart(center, radius, axis)
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None
    found: dict[str, KeepOut] = {}
    for table in _list(tables, "keep_out", MAX_KEEP_OUTS):
        name = _name(table, "keep_out", _KEEP_OUT, found)
        found[name] = _keep_out(name, table, parts)
    return tuple(found.values())


def _keep_out(name: str, table: Mapping[str, Any], parts: Mapping[str, BodyPart]) -> KeepOut:
    where = f"keep_out {name!r}"
    chosen = table.get("parts", list(parts))
    known = [isinstance(p, str) and p in parts for p in chosen] if isinstance(chosen, list) else []
    if not isinstance(chosen, list) or not all(known):
        wrong = chosen[known.index(False)] if known else chosen
        names = ", ".join(parts) or "none, add [[part]]"
        raise ValueError(f"{where}: parts has {wrong!r:.40}; known: {names}")
    given: dict[str, Any] = {k: _number(table[k], f"{where}: {k}") for k in _NUMBERS if k in table}
    if "normal" in table:
        given["normal"] = _direction(table["normal"], f"{where}: normal")
    if "frame" in table:
        if table["frame"] not in list(PlaneFrame):
            raise ValueError(f"{where}: frame = {table['frame']!r:.40} must be target or world")
        given["frame"] = PlaneFrame(table["frame"])
    return KeepOut(name, tuple(parts[p] for p in chosen), **given)


def _list(tables: Mapping[str, Any], key: str, most: int) -> list[Mapping[str, Any]]:
    found = tables.get(key, [])
    if not isinstance(found, list) or not all(isinstance(table, dict) for table in found):
        raise ValueError(f"{key} must be a list of tables, [[{key}]]")
    if len(found) > most:
        raise ValueError(f"{len(found)} tables [[{key}]]; at most {most}")
    return found


def _name(
    table: Mapping[str, Any], kind: str, known: tuple[str, ...], taken: Mapping[str, object]
) -> str:
    name = table.get("name")
    if not (isinstance(name, str) and 1 <= len(name) <= MAX_NAME and name.isprintable()):
        raise ValueError(f"[[{kind}]]: name = {name!r:.60} must be 1 to {MAX_NAME} characters")
    if name in taken:
        raise ValueError(f"{kind} {name!r} is there twice")
    for key in table:
        if key not in known:
            raise ValueError(f"{kind} {name!r}: unknown {key!r:.40}; known: {', '.join(known)}")
    return name


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{where} = {value!r:.40} must be a number")
    if not -LARGEST <= value <= LARGEST:
        raise ValueError(f"{where} = {value!r:.40} is not within {LARGEST:g}")
    return float(value)


def _vector(value: object, where: str) -> Vec3:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{where} = {value!r:.60} must be three numbers")
    x, y, z = (_number(c, where) for c in value)
    return x, y, z


def _direction(value: object, where: str) -> Vec3:
    direction = _vector(value, where)
    length = norm(direction)
    if not (length >= 1e-3 and is_bounded(direction, LARGEST)):
        raise ValueError(f"{where} = {value!r:.60} has no direction")
    return scaled(direction, 1.0 / length)
