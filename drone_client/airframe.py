"""Where camera and arm sit on the drone, and how much room its body takes."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drone_client.cbf.keep_out import MAX_KEEP_OUTS, BodyPart, KeepOut, PlaneFrame
from drone_client.cbf.keep_out_table import keep_outs_from
from drone_client.errors import AirframeError
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Array, Pose, rotation_from_vector

FLU_FROM_RDF = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation of a camera that looks straight ahead: its z is the body's x, its x the body's -y."""
CAMERA_DOWN_RAD = math.radians(10.0)
MAX_AIRFRAME_BYTES = 65_536
MAX_ARM_M = 5.0
"""Nothing on a drone is further than this from its body; metres are easily mistaken."""


_QUADROTOR = [
    {"name": "body", "center_body_m": [0.0, 0.0, 0.0], "radius_m": 0.22},
    *(
        {
            "name": f"{fore} {side} propeller",
            "center_body_m": [0.23 * x, 0.23 * y, 0.05],
            "radius_m": 0.17,
            "axis_body": [0.0, 0.0, 1.0],
        }
        for fore, x in (("front", 1), ("rear", -1))
        for side, y in (("left", 1), ("right", -1))
    ),
]
"""A frame of 650 mm with propellers of 13 inches."""
_WALL_CLEARANCE_M = 0.08
_FACING = 0.99
"""Cosine of a plane's normal with the target's x from which it may be the board's wall."""
_BEHIND_M = 0.5
"""So far behind the board it still is: the board hangs on something."""


@dataclass(frozen=True, slots=True, eq=False)
class Airframe:
    """Fixed transforms of the drone; the defaults are those of the simulated one."""

    body_from_camera: Pose = field(
        default_factory=lambda: Pose.from_rotation(
            rotation_from_vector(np.array([0.0, CAMERA_DOWN_RAD, 0.0])) @ FLU_FROM_RDF,
            np.array([0.12, 0.0, 0.1]),
        )
    )
    """Colour camera (RDF) in the body (FLU). Well above the arm and turned down: nearer to it, the
    arm hides the middle of a target that is some metres away; level, the target's lower edge leaves
    the picture before the touch."""
    body_from_tip: Pose = field(
        default_factory=lambda: Pose(np.array([0.55, 0.0, 0.0]), Pose.identity().q_wxyz)
    )
    """End of the unloaded arm; its axes are the body's."""
    keep_outs: tuple[KeepOut, ...] = field(default_factory=lambda: _keep_outs({}))
    """What propellers and body stay clear of; at least the wall of the target."""
    assumed: tuple[str, ...] = ()
    """What its file does not say, and is flown as of the default drone."""

    def floor(self, height_m: float) -> KeepOut:
        """A floor at a height in the odometry's world [m]."""
        return KeepOut("floor", self._parts, (0.0, 0.0, 1.0), height_m, PlaneFrame.WORLD)

    def ceiling(self, height_m: float) -> KeepOut:
        """A ceiling at a height in the odometry's world [m]."""
        return KeepOut("ceiling", self._parts, (0.0, 0.0, -1.0), -height_m, PlaneFrame.WORLD)

    def planes(self, floor_m: float | None, ceiling_m: float | None) -> tuple[KeepOut, ...]:
        """Its own planes, with a floor and a ceiling where there are any [m].

        Raises:
            ValueError: a height is none, or there are more planes than the safety filter takes.
        """
        planes = (
            *self.keep_outs,
            *(() if floor_m is None else (self.floor(floor_m),)),
            *(() if ceiling_m is None else (self.ceiling(ceiling_m),)),
        )
        if len(planes) > MAX_KEEP_OUTS:
            raise ValueError(
                f"{len(planes)} planes with wall, floor and ceiling, and the safety filter takes "
                f"{MAX_KEEP_OUTS}: leave out {len(planes) - MAX_KEEP_OUTS} [[keep_out]] of the "
                "airframe"
            )
        return planes

    @property
    def _parts(self) -> tuple[BodyPart, ...]:
        return tuple(dict.fromkeys(part for plane in self.keep_outs for part in plane.parts))


def load_airframe(path: Path) -> Airframe:
    """Read an airframe TOML.

    It may hold ``[body_from_camera]`` and ``[body_from_tip]``, each with ``translation_m`` and an
    optional ``q_wxyz``; ``[[part]]`` for each propeller and part of the body, and ``[[keep_out]]``
    for each plane that they stay clear of (``cbf/keep_out_table.py``). The wall of the target is
    one of them whatever the file says; a plane of its own that faces as the board does takes its
    place. What is left out keeps its default, and is named in ``assumed``.

    Raises:
        AirframeError: with the path, the field at fault and what it may be.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_AIRFRAME_BYTES + 1)
        if len(data) > MAX_AIRFRAME_BYTES:
            raise AirframeError(f"over {MAX_AIRFRAME_BYTES} bytes")
        raw = tomllib.loads(data.decode("utf-8"))
        known = ("body_from_camera", "body_from_tip", "part", "keep_out")
        _check_keys("the file", raw, known)
        defaults = Airframe()
        return Airframe(
            _pose(raw, "body_from_camera", defaults.body_from_camera),
            _pose(raw, "body_from_tip", defaults.body_from_tip),
            _keep_outs(raw),
            tuple(name for name in known if name not in raw and name != "keep_out"),
        )
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
    except (GeometryError, TypeError, ValueError, OverflowError) as error:
        raise AirframeError(f"[{name}]: {error}") from None
    if float(np.linalg.norm(pose.translation)) > MAX_ARM_M:
        raise AirframeError(
            f"[{name}] lies over {MAX_ARM_M:g} m from the body: translation_m = {translation}"
        )
    return pose


def _keep_outs(raw: dict[str, Any]) -> tuple[KeepOut, ...]:
    parts = raw.get("part", _QUADROTOR)
    own = keep_outs_from({"part": parts, "keep_out": raw.get("keep_out", [])})
    if any(_is_targets_wall(plane) for plane in own):
        return own
    name = "wall" if all(plane.name != "wall" for plane in own) else "target's wall"
    wall = {"name": name, "clearance_m": _WALL_CLEARANCE_M}
    return (*keep_outs_from({"part": parts, "keep_out": [wall]}), *own)


def _is_targets_wall(plane: KeepOut) -> bool:
    faces = plane.frame is PlaneFrame.TARGET and plane.normal[0] >= _FACING
    return faces and plane.offset_m >= -_BEHIND_M
