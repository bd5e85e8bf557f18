"""Where camera and arm sit on the drone."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drone_client.errors import AirframeError
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Array, Pose

FLU_FROM_RDF = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation of a camera that looks straight ahead: its z is the body's x, its x the body's -y."""


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


def load_airframe(path: Path) -> Airframe:
    """Read an airframe TOML.

    It may hold ``[body_from_camera]`` and ``[body_from_tip]``, each with ``translation_m`` and an
    optional ``q_wxyz``; what is left out keeps its default.

    Raises:
        AirframeError: with the path, the field at fault and what it may be.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        unknown = set(raw) - {"body_from_camera", "body_from_tip"}
        if unknown:
            raise AirframeError(f"unknown {', '.join(sorted(unknown))}")
        defaults = Airframe()
        return Airframe(
            _pose(raw, "body_from_camera", defaults.body_from_camera),
            _pose(raw, "body_from_tip", defaults.body_from_tip),
        )
    except OSError as error:
        raise AirframeError(f"airframe file {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, AirframeError) as error:
        raise AirframeError(f"airframe file {path}: {error}") from None


def _pose(raw: dict[str, Any], name: str, default: Pose) -> Pose:
    if name not in raw:
        return default
    table = raw[name]
    if not isinstance(table, dict) or "translation_m" not in table:
        raise AirframeError(f"[{name}] lacks translation_m")
    if unknown := set(table) - {"translation_m", "q_wxyz"}:
        raise AirframeError(f"[{name}] has unknown {', '.join(sorted(unknown))}")
    try:
        translation: Array = np.asarray(table["translation_m"], dtype=np.float64)
        q_wxyz: Array = np.asarray(table.get("q_wxyz", default.q_wxyz), dtype=np.float64)
        pose = Pose(translation, q_wxyz)
    except (GeometryError, TypeError, ValueError) as error:
        raise AirframeError(f"[{name}]: {error}") from None
    if float(np.linalg.norm(pose.translation)) > 5.0:
        raise AirframeError(f"[{name}] lies over 5 m from the body: {pose.translation}")
    return pose
