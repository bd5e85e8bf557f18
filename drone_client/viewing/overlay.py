"""A found target in the camera's picture: the lines that people see over it."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drone_client.viewing.facts import FlightFacts
from drone_client.viewing.moments import Settled
from drone_client.viewing.outlines import Rgb, board_outlines
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose import lens

ACCEPTED: Final[Rgb] = (0.25, 0.95, 0.35)
REFUSED: Final[Rgb] = (1.0, 0.35, 0.25)
AXES: Final[tuple[Rgb, Rgb, Rgb]] = ((1.0, 0.25, 0.25), (0.3, 0.9, 0.3), (0.35, 0.55, 1.0))
"""Of x (out of the board), y (left) and z (up)."""
NEAREST_M: Final = 0.05
"""What is nearer to the camera's plane, or behind it, has no place in its picture."""


class Mark(NamedTuple):
    """A line strip in the picture."""

    points_px: NDArray[np.float64]  # (n, 2)
    color: Rgb


def project(
    points: NDArray[np.float64], camera_from_frame: Pose, intrinsics: CameraIntrinsics
) -> NDArray[np.float64] | None:
    """Pixels (n, 2) of points (n, 3) of a frame; None: not all of them have a place there."""
    in_camera = points @ camera_from_frame.rotation.T + camera_from_frame.translation
    if in_camera[:, 2].min() < NEAREST_M:
        return None
    pixels = lens.project(in_camera, intrinsics)
    return pixels if np.isfinite(pixels).all() else None


def marks(settled: Settled, facts: FlightFacts) -> list[Mark]:
    """The found target in its own picture: outline in the colour of the verdict, and axes."""
    if settled.camera_from_target is None:
        return []
    color = ACCEPTED if settled.accepted else REFUSED
    length = facts.board_side_m / 2
    lines = [(o.points, color) for o in board_outlines(facts)]
    lines += [(np.stack((np.zeros(3), length * np.eye(3)[i])), AXES[i]) for i in range(3)]
    found = []
    for points, shade in lines:
        pixels = project(points, settled.camera_from_target, facts.camera.color)
        if pixels is not None:
            found.append(Mark(pixels, shade))
    return found


def caption(settled: Settled) -> str:
    """The verdict on a frame, and how old the answer was."""
    words = settled.verdict.replace("_", " ")
    outcome = settled.line.get("outcome")
    if outcome not in (None, "target"):
        words += f" ({str(outcome).replace('_', ' ')})"
    age_ms = settled.line.get("age_ms")
    return words if age_ms is None else f"{words}, {age_ms:.0f} ms old"
