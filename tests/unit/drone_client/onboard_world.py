"""A drone, a wall and a target, for the tests of what is seen on board."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drone_client.reception import EdgeWord
from drone_client.target import TargetEstimate
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose, rotation_from_vector
from target_pose.target import load_target
from tests.unit.drone_client.builders import MS
from tests.unit.target_pose.render import Look, facing_pose, render_color, render_depth

TARGET = load_target()
LENS = CameraIntrinsics(640, 480, 385.0, 385.0, 319.5, 239.5)
CAMERA = RgbdCamera(
    LENS, CameraIntrinsics(320, 240, 190.0, 190.0, 159.5, 119.5), 0.001, Pose.identity()
)
COVARIANCE = np.diag([4e-6] * 3 + [2e-5] * 3)
T0_NS = 1_000 * MS
"""Exposure of the edge's last word."""
WORLD_FROM_CAMERA = Pose.from_rotation(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.5, 0.2, 1.4])
)
SEEN = facing_pose((0.1, -0.05, 1.5), tilt_rad=0.3, tilt_azimuth_rad=0.4)
"""``camera_from_target`` from there."""
WORLD_FROM_TARGET = WORLD_FROM_CAMERA @ SEEN


def edge_estimate(t_ns: int = T0_NS, world_from_target: Pose = WORLD_FROM_TARGET, **changes):
    """What the edge knows."""
    known = TargetEstimate(world_from_target, COVARIANCE, t_ns, 1.5)
    return replace(known, **changes)


def said(t_ns: int = T0_NS, **changes) -> EdgeWord:
    """The edge's last word, of an exposure at ``t_ns``."""
    return EdgeWord(edge_estimate(t_ns, **changes), None)


def perturbed(pose: Pose, step) -> Pose:
    """A pose moved and turned from the left: (dx, dy, dz, rx, ry, rz)."""
    step = np.asarray(step, dtype=float)
    return Pose.from_rotation(
        rotation_from_vector(step[3:]) @ pose.rotation, pose.translation + step[:3]
    )


def picture(
    camera_from_target: Pose = SEEN,
    t_ns: int = T0_NS + 350 * MS,
    *,
    depth: bool = True,
    seed: int = 0,
    target=TARGET,
    dim: float = 1.0,
) -> RgbdFrame:
    """A frame that shows the target at a pose."""
    rng = np.random.default_rng(seed)
    look = Look(supersample=4, noise=1.5, wall_gap_m=0.02, dim=dim)
    color = render_color(target, LENS, camera_from_target, look, rng)
    units = (
        render_depth(target, CAMERA, camera_from_target, look, rng, noise=0.002) if depth else None
    )
    return RgbdFrame(color, units, CAMERA, t_ns, WORLD_FROM_CAMERA)
