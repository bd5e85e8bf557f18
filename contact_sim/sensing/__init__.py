"""The sensors of the simulated drone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose, rotation_from_vector

BASELINE_M = 0.095
"""Between a D455's eyes."""


def d455() -> RgbdCamera:
    """The rig that flies by default: colour at 640x480, raw depth at 424x240 of its own place."""
    f = 214.2
    turn = rotation_from_vector(np.array([0.0012, -0.0021, 0.0008]))
    return RgbdCamera(
        CameraIntrinsics(640, 480, 385.4, 384.9, 321.3, 238.6),
        CameraIntrinsics(424, 240, f, f, 211.7, 119.2),
        0.001,
        Pose.from_rotation(turn, np.array([-0.059, 0.0002, -0.0001])),
        f * BASELINE_M * 32,
    )


def as_built(rig: RgbdCamera, rng: np.random.Generator) -> RgbdCamera:
    """The rig as it truly is where its calibration says ``rig``: what a world is drawn through.

    Focal lengths are off by a tenth of a percent and principal points by a third of a pixel, as a
    factory's calibration is after some months of flying.
    """

    def truly(i: CameraIntrinsics) -> CameraIntrinsics:
        scale, aspect = 1 + rng.normal(0, 1e-3), 1 + rng.normal(0, 2e-4)
        cx, cy = rng.normal((i.cx, i.cy), 0.3)
        return replace(i, fx=i.fx * scale, fy=i.fy * scale * aspect, cx=float(cx), cy=float(cy))

    return replace(rig, color=truly(rig.color), depth=truly(rig.depth))
