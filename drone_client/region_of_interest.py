"""Where the target must be in a picture: what deserves full resolution.

A ball around the target's centre, as large as the board, and growing with the age of what is
known, is put into the colour picture. Too large costs bytes; too small costs the target's depth,
so every doubt makes it larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose

BOARD_RADIUS_M = 0.35
"""From the centre to a corner of the largest board that is usual (0.4 m), and its edge against
the wall."""
SPEED_MPS = 0.5
"""How fast the target may move against what is believed: the drone's top speed and its drift."""
MARGIN_PX = 24
MIN_DISTANCE_M = 0.15
"""Nearer than this the whole picture is the target."""


@dataclass(frozen=True, slots=True)
class RegionOfInterest:
    """A part of the colour picture, and how far away what it shows is."""

    x0: int
    y0: int
    x1: int
    """Behind the last column."""
    y1: int
    near_m: float
    far_m: float


def region_around(
    world_from_target: Pose, world_from_camera: Pose, age_ns: int, color: CameraIntrinsics
) -> RegionOfInterest | None:
    """The region of a target that was seen a while ago; None: it is not in the picture.

    Args:
        world_from_target: where it is believed to be.
        world_from_camera: the colour camera at the exposure of the picture.
        age_ns: of what is believed, at that exposure.
        color: intrinsics of the colour camera; the lens's distortion is left to the margin.
    """
    center = world_from_camera.inverse() @ world_from_target
    x, y, z = center.translation.tolist()
    radius_m = BOARD_RADIUS_M + SPEED_MPS * max(0, age_ns) / 1e9
    far_m = float(np.linalg.norm((x, y, z))) + radius_m
    if z < -radius_m:
        return None
    near_m = z - radius_m
    if near_m < MIN_DISTANCE_M:
        return RegionOfInterest(0, 0, color.width, color.height, MIN_DISTANCE_M, far_m)
    # The ball lies in a box of its radius; a corner of the box that is nearer looks larger
    us = [
        color.cx + color.fx * (x + side * radius_m) / d for side in (-1, 1) for d in (near_m, far_m)
    ]
    vs = [
        color.cy + color.fy * (y + side * radius_m) / d for side in (-1, 1) for d in (near_m, far_m)
    ]
    x0, x1 = max(0, int(min(us)) - MARGIN_PX), min(color.width, int(max(us)) + MARGIN_PX + 1)
    y0, y1 = max(0, int(min(vs)) - MARGIN_PX), min(color.height, int(max(vs)) + MARGIN_PX + 1)
    if x0 >= x1 or y0 >= y1:
        return None
    return RegionOfInterest(x0, y0, x1, y1, near_m, far_m)
