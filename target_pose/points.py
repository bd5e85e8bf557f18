"""Labelled points: where they lie on a board by its TOML file, and where a picture shows them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from target_pose.errors import TargetFileError

MIN_POINTS, MAX_POINTS = 4, 64
"""Three points of a plane have up to four poses; with four only the two folds are left."""
MIN_APART_M = 0.001
MIN_BREADTH = 0.05
"""Least spread of the points across their longest direction over that along it: nearer to a line
than this, they say nothing of the tilt about it."""
NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,31}"


@dataclass(frozen=True, slots=True)
class BoardPoint:
    """A point of the board that can be told from all others, in the frame ``target``."""

    name: str
    y_m: float
    """To a viewer's right of the board's centre."""
    z_m: float
    """Up along the board from its centre."""


class PointPx(NamedTuple):
    """A labelled point in the colour picture; pixel (0, 0) is the centre of the first pixel."""

    u: float
    v: float
    confidence: float
    """That it is seen at all, in [0, 1]."""


def parse_points(raw: object, board_side_m: float) -> tuple[BoardPoint, ...]:
    """The points of a target file's ``[[points]]``, in its order.

    Raises:
        TargetFileError: there are too few or too many, one is malformed, off the board or in
            another's place, or all lie on one line; says which and why.
    """
    if not isinstance(raw, list) or not MIN_POINTS <= len(raw) <= MAX_POINTS:
        count = len(raw) if isinstance(raw, list) else repr(raw)[:40]
        raise TargetFileError(f"a target has {MIN_POINTS} to {MAX_POINTS} [[points]], not {count}")
    points = tuple(_point(each, board_side_m) for each in raw)
    for k, one in enumerate(points):
        for other in points[:k]:
            if one.name == other.name:
                raise TargetFileError(f"two points are called {one.name!r}")
            if math.dist((one.y_m, one.z_m), (other.y_m, other.z_m)) < MIN_APART_M:
                raise TargetFileError(
                    f"points {other.name} and {one.name} are less than {MIN_APART_M} m apart"
                )
    if breadth(np.array([(p.y_m, p.z_m) for p in points])) < MIN_BREADTH:
        raise TargetFileError("all points lie on one line, from which no tilt can be told")
    return points


def breadth(yz_m: NDArray[np.float64]) -> float:
    """Spread of points (N, 2) across their longest direction over that along it, in [0, 1]."""
    along, across = np.linalg.svd(yz_m - yz_m.mean(axis=0), compute_uv=False)
    return float(across / along) if along > 0 else 0.0


def _point(raw: object, board_side_m: float) -> BoardPoint:
    if not isinstance(raw, dict) or set(raw) != {"name", "y_m", "z_m"}:
        raise TargetFileError(f"each of [[points]] has name, y_m and z_m, not {str(raw)[:60]}")
    name = raw["name"]
    if not isinstance(name, str) or not re.fullmatch(NAME_PATTERN, name):
        raise TargetFileError(
            f"a point's name is 1 to 32 of A-Z, a-z, 0-9, _, . and -, not {str(name)[:40]!r}"
        )
    return BoardPoint(name, *(_coordinate(name, raw, axis, board_side_m) for axis in _AXES))


def _coordinate(name: str, raw: dict[str, Any], axis: str, board_side_m: float) -> float:
    value = raw[axis]
    half = board_side_m / 2
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TargetFileError(f"point {name}: {axis} must be in metres, not {str(value)[:40]!r}")
    if not -half <= value <= half:  # false for NaN, too
        raise TargetFileError(
            f"point {name}: {axis} = {str(value)[:20]} m is not on the board, [-{half}, {half}]"
        )
    return float(value)


_AXES = ("y_m", "z_m")
