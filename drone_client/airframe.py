"""Where camera and arm sit on the drone, and how much room its body takes."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drone_client.cbf.keep_out import MAX_PARTS, BodyPart, KeepOut, PlaneFrame
from drone_client.cbf.vector import Vec3
from drone_client.errors import AirframeError
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Array, Pose

FLU_FROM_RDF = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation of a camera that looks straight ahead: its z is the body's x, its x the body's -y."""
MAX_AIRFRAME_BYTES = 65_536
MAX_ARM_M = 5.0
"""Nothing on a drone is further than this from its body; metres are easily mistaken."""


_QUADROTOR = (
    BodyPart((0.0, 0.0, 0.0), 0.22),
    *(
        BodyPart((0.23 * x, 0.23 * y, 0.05), 0.17, (0.0, 0.0, 1.0))
        for x in (-1.0, 1.0)
        for y in (-1.0, 1.0)
    ),
)
"""A frame of 650 mm with propellers of 13 inches."""


@dataclass(frozen=True, slots=True, eq=False)
class Airframe:
    """Fixed transforms of the drone; the defaults are those of the simulated one."""

    body_from_camera: Pose = field(
        default_factory=lambda: Pose.from_rotation(FLU_FROM_RDF, np.array([0.12, 0.0, 0.05]))
    )
    """Colour camera (RDF) in the body (FLU)."""
    body_from_tip: Pose = field(
        default_factory=lambda: Pose(np.array([0.55, 0.0, 0.0]), Pose.identity().q_wxyz)
    )
    """End of the unloaded arm; its axes are the body's."""
    parts: tuple[BodyPart, ...] = field(default_factory=lambda: _QUADROTOR)
    """Propellers and body: what may touch nothing."""
    wall_clearance_m: float = 0.08
    """What they keep from the target's wall beside the error ball."""

    @property
    def wall(self) -> KeepOut:
        """The wall that the target hangs on; the arm alone may touch it."""
        return KeepOut("wall", self.parts, clearance_m=self.wall_clearance_m)

    def floor(self, height_m: float) -> KeepOut:
        """A floor at a height in the odometry's world [m]."""
        return KeepOut("floor", self.parts, (0.0, 0.0, 1.0), height_m, PlaneFrame.WORLD)

    def ceiling(self, height_m: float) -> KeepOut:
        """A ceiling at a height in the odometry's world [m]."""
        return KeepOut("ceiling", self.parts, (0.0, 0.0, -1.0), -height_m, PlaneFrame.WORLD)


def load_airframe(path: Path) -> Airframe:
    """Read an airframe TOML.

    It may hold ``[body_from_camera]`` and ``[body_from_tip]``, each with ``translation_m`` and an
    optional ``q_wxyz``; ``[[part]]`` for each propeller and part of the body, with ``center_m``,
    ``radius_m`` and, for a flat disc, its ``axis``; and ``wall_clearance_m``. What is left out
    keeps its default.

    Raises:
        AirframeError: with the path, the field at fault and what it may be.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_AIRFRAME_BYTES + 1)
        if len(data) > MAX_AIRFRAME_BYTES:
            raise AirframeError(f"over {MAX_AIRFRAME_BYTES} bytes")
        raw = tomllib.loads(data.decode("utf-8"))
        known = ("body_from_camera", "body_from_tip", "part", "wall_clearance_m")
        _check_keys("the file", raw, known)
        defaults = Airframe()
        airframe = Airframe(
            _pose(raw, "body_from_camera", defaults.body_from_camera),
            _pose(raw, "body_from_tip", defaults.body_from_tip),
            _parts(raw["part"]) if "part" in raw else defaults.parts,
            _number(raw.get("wall_clearance_m", defaults.wall_clearance_m), "wall_clearance_m"),
        )
        _ = airframe.wall  # its bounds are checked where they are at home
        return airframe
    except OSError as error:
        raise AirframeError(f"airframe file {path}: {error.strerror}") from None
    except (ValueError, RecursionError, AirframeError) as error:
        raise AirframeError(f"airframe file {path}: {error}") from None


def _check_keys(where: str, table: dict[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            raise AirframeError(f"{where} has unknown {key[:40]!r}; known: {', '.join(known)}")


def _pose(raw: dict[str, Any], name: str, default: Pose) -> Pose:
    if name not in raw:
        return default
    table = raw[name]
    if not isinstance(table, dict) or "translation_m" not in table:
        raise AirframeError(f"[{name}] lacks translation_m")
    _check_keys(f"[{name}]", table, ("translation_m", "q_wxyz"))
    try:
        translation: Array = np.asarray(table["translation_m"], dtype=np.float64)
        q_wxyz: Array = np.asarray(table.get("q_wxyz", default.q_wxyz), dtype=np.float64)
        pose = Pose(translation, q_wxyz)
    except (GeometryError, TypeError, ValueError) as error:
        raise AirframeError(f"[{name}]: {error}") from None
    if float(np.linalg.norm(pose.translation)) > MAX_ARM_M:
        raise AirframeError(
            f"[{name}] lies over {MAX_ARM_M:g} m from the body: translation_m = {translation}"
        )
    return pose


def _parts(raw: object) -> tuple[BodyPart, ...]:
    if not isinstance(raw, list) or not 1 <= len(raw) <= MAX_PARTS:
        raise AirframeError(f"[[part]] must be there 1 to {MAX_PARTS} times")
    parts = []
    for number, table in enumerate(raw, 1):
        where = f"[[part]] number {number}"
        if not isinstance(table, dict) or not {"center_m", "radius_m"} <= table.keys():
            raise AirframeError(f"{where} lacks center_m or radius_m")
        _check_keys(where, table, ("center_m", "radius_m", "axis"))
        axis = None if "axis" not in table else _triple(table["axis"], f"{where}: axis")
        center = _triple(table["center_m"], f"{where}: center_m")
        radius = _number(table["radius_m"], f"{where}: radius_m")
        try:
            parts.append(BodyPart(center, radius, axis))
        except ValueError as error:
            raise AirframeError(f"{where}: {error}") from None
    return tuple(parts)


def _triple(raw: object, where: str) -> Vec3:
    if not isinstance(raw, list) or len(raw) != 3:
        raise AirframeError(f"{where} must be three numbers")
    x, y, z = (_number(v, where) for v in raw)
    return x, y, z


def _number(raw: object, where: str) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise AirframeError(f"{where} must be a number")
    return float(raw)
