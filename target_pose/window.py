"""Boxes where a pose puts a target: the candidate of somebody who has no net, but remembers."""

from __future__ import annotations

import math

import numpy as np

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Array, Pose
from target_pose.candidate import Box
from target_pose.lens import project
from target_pose.rings import is_board
from target_pose.target import Level, Target

NO_NET = 0.0
"""Score of a box that no detector vouches for."""
RIM_POINTS = 24
"""A circle's box from so many points is at most 1 % too small."""


def projected_boxes(
    target: Target, camera_from_target: Pose, intrinsics: CameraIntrinsics
) -> dict[Level, Box]:
    """The boxes that a detector would draw around a target at ``camera_from_target``.

    They may reach out of the picture. A level of which a part is not ahead of the camera, or has
    no image through its lens, is left out.
    """
    boxes = {}
    for level, side_m in target.level_m.items():
        rim = _SQUARE if is_board(level, target) else _CIRCLE
        uv = project(camera_from_target @ (rim * side_m / 2), intrinsics)
        if np.isfinite(uv).all():
            (x0, y0), (x1, y1) = uv.min(axis=0).tolist(), uv.max(axis=0).tolist()
            boxes[level] = Box(x0, y0, x1, y1, NO_NET)
    return boxes


def share_in_picture(box: Box, intrinsics: CameraIntrinsics) -> float:
    """Share of a box's area that lies in the picture, in [0, 1]."""
    share = 1.0
    ends = ((box.x0, box.x1, intrinsics.width), (box.y0, box.y1, intrinsics.height))
    for low, high, size in ends:
        if not high > low:
            return 0.0
        share *= max(min(high, size - 0.5) - max(low, -0.5), 0.0) / (high - low)
    return share


def _rim(y: Array, z: Array) -> Array:
    """Points (N, 3) on the board, frame ``target``."""
    return np.stack([np.zeros_like(y), y, z], axis=1)


_ANGLES = np.arange(RIM_POINTS) * (2 * math.pi / RIM_POINTS)
_CIRCLE = _rim(np.cos(_ANGLES), np.sin(_ANGLES))
_SQUARE = _rim(np.array([-1.0, -1.0, 1.0, 1.0]), np.array([-1.0, 1.0, -1.0, 1.0]))
