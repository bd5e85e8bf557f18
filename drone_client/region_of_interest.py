"""Where the target must be in a picture: what of the depth deserves full resolution.

A ball around the target's centre, as large as the board, and growing with the age of what is
known, is put into the depth picture. Too large costs bytes; too small costs the target's depth, so
every doubt makes it larger.
"""

from __future__ import annotations

import math

from rgbd_wire.camera import RgbdCamera
from rgbd_wire.depth import Region
from rgbd_wire.geometry import Pose

BOARD_RADIUS_M = 0.35
"""From the centre to a corner of the largest board that is usual (0.4 m), and a hand's breadth of
wall around it."""
SPEED_MPS = 0.5
"""How fast the target may move against what is believed: the drone's top speed and its drift."""
MARGIN_PX = 16
"""For the lens's distortion, which is left out here."""


def depth_region(
    world_from_target: Pose, world_from_camera: Pose, age_ns: int, camera: RgbdCamera
) -> Region | None:
    """The part of the depth picture that shows a target; None: the target is not in it.

    Args:
        world_from_target: where it is believed to be.
        world_from_camera: the colour camera at the exposure of the picture.
        age_ns: of what is believed, at that exposure.
        camera: the rig.
    """
    depth_from_camera = camera.color_from_depth.inverse()
    center = (depth_from_camera @ world_from_camera.inverse() @ world_from_target).translation
    x, y, z = center.tolist()
    radius_m = BOARD_RADIUS_M + SPEED_MPS * max(0, age_ns) / 1e9
    if z < -radius_m:
        return None
    lens = camera.depth
    left, right = _tangents(x, z, radius_m)
    top, bottom = _tangents(y, z, radius_m)
    x0, x1 = _span(lens.cx + lens.fx * left, lens.cx + lens.fx * right, lens.width)
    y0, y1 = _span(lens.cy + lens.fy * top, lens.cy + lens.fy * bottom, lens.height)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def _tangents(aside_m: float, ahead_m: float, radius_m: float) -> tuple[float, float]:
    """Slopes of the two rays that touch a disc; infinite where they do not point ahead."""
    distance_m = math.hypot(aside_m, ahead_m)
    if distance_m <= radius_m:
        return -math.inf, math.inf
    middle, half = math.atan2(aside_m, ahead_m), math.asin(radius_m / distance_m)
    low, high = middle - half, middle + half
    right_angle = math.pi / 2
    return (
        math.tan(low) if abs(low) < right_angle else math.copysign(math.inf, low),
        math.tan(high) if abs(high) < right_angle else math.copysign(math.inf, high),
    )


def _span(low_px: float, high_px: float, side_px: int) -> tuple[int, int]:
    """First pixel and the one behind the last, with the margin, within the picture."""
    first = min(max(low_px - MARGIN_PX, 0.0), float(side_px))
    behind = min(max(high_px + MARGIN_PX + 1.0, 0.0), float(side_px))
    return math.floor(first), math.ceil(behind)
