"""Where the target must be in a picture: what of the depth deserves full resolution.

A ball around the target's centre, as large as the board, and growing with the age of what is
known, is put into the depth picture. Too large costs bytes; too small costs the target's depth, so
every doubt makes it larger.
"""

from __future__ import annotations

import numpy as np

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
MIN_DISTANCE_M = 0.15
"""Nearer than this, the whole picture is the target."""


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
    lens = camera.depth
    if z < -radius_m:
        return None
    near_m, far_m = z - radius_m, z + radius_m
    if near_m < MIN_DISTANCE_M:
        return 0, 0, lens.width, lens.height
    # The ball lies in a box of its radius, and that between its corners' rays
    distances_m = np.array([near_m, far_m])
    us = lens.cx + lens.fx * (x + radius_m * np.array([[-1.0], [1.0]])) / distances_m
    vs = lens.cy + lens.fy * (y + radius_m * np.array([[-1.0], [1.0]])) / distances_m
    x0, x1 = max(0, int(us.min()) - MARGIN_PX), min(lens.width, int(us.max()) + MARGIN_PX + 2)
    y0, y1 = max(0, int(vs.min()) - MARGIN_PX), min(lens.height, int(vs.max()) + MARGIN_PX + 2)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None
