"""From how far a camera sees a target: plain pinhole arithmetic, head-on."""

from __future__ import annotations

from typing import NamedTuple

from target_pose.target import Target

LEAST_PX = 14.0
"""Width of the board in the picture down to which the detector is measured."""


class Reach(NamedTuple):
    """Distances of the board's centre from the camera [m]."""

    far_m: float
    """The board is 14 px wide."""
    near_m: float
    """The board fills the picture: any closer, and its edges leave it."""


def reach(target: Target, fx_px: float, width_px: int, height_px: int) -> Reach:
    """Between which distances a camera with square pixels sees the whole board well enough."""
    ray = fx_px * target.board_side_m
    return Reach(ray / LEAST_PX, ray / min(width_px, height_px))
