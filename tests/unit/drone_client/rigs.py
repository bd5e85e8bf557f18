"""Sightings of a target by a rig whose errors are known, by definition alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from drone_client.calibration.sighting import Circles, Sighting
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from target_pose.plane import InverseDepthPlane

COLOR = CameraIntrinsics(640, 480, 385.0, 385.0, 320.0, 240.0)
DEPTH = CameraIntrinsics(424, 240, 214.0, 214.0, 212.0, 120.0)
TRUE = Pose(np.array([-0.059, 0.0002, -0.0001]), np.array([1.0, 0.0, 0.0, 0.0]))
CAMERA = RgbdCamera(COLOR, DEPTH, 0.001, TRUE)


def wrong(camera, scale=0.0, shift_m=(0, 0, 0), turn_rad=(0, 0, 0)):
    """The camera file of a true rig, with errors put in."""
    turn = Rotation.from_rotvec(turn_rad).as_matrix()
    true = camera.color_from_depth
    pose = Pose.from_rotation(turn @ true.rotation, true.translation + np.asarray(shift_m))
    return replace(camera, color_from_depth=pose, depth_scale_m=camera.depth_scale_m * (1 + scale))


def tour(count, rng, ranges=(0.7, 3.0), tilt_deg=40.0, aim=0.15):
    """Centres and normals of a target as a good recording shows it."""
    for i in range(count):
        range_m = ranges[0] + (ranges[1] - ranges[0]) * i / max(count - 1, 1)
        ray = np.array([*rng.uniform(-aim, aim, 2), 1.0])
        center = range_m * ray / np.linalg.norm(ray)
        way = rng.uniform(0, 2 * np.pi)
        axis = np.cross(center, [np.cos(way), np.sin(way), 0.3])
        lean = Rotation.from_rotvec(
            np.radians(rng.uniform(0.3, 1.0) * tilt_deg) * axis / np.linalg.norm(axis)
        )
        yield center, lean.apply(-center / range_m)


def sighting(center, normal, scale=0.0, noise=0.0, rng=None, name="x"):
    """What a rig with a true ``color_from_depth`` and a depth that is too long measures."""
    depth_from_color = TRUE.inverse()
    n = depth_from_color.rotation @ normal
    d = float(n @ (depth_from_color @ center)) * (1 + scale)
    range_m = float(np.linalg.norm(center))
    if noise:
        n = Rotation.from_rotvec(rng.normal(0, 0.004 * noise, 3)).apply(n)
        pivot = (depth_from_color @ center) * (1 + scale)
        d = float(n @ pivot) + rng.normal(0, 1e-3 * noise * range_m)
        center = center * (1 + rng.normal(0, 5e-4 * noise))
    plane = InverseDepthPlane(n / d, np.eye(3), 900, 2e-3)
    return Sighting(name, Circles(center, normal, 1e-3, 2e-3), 1 + scale, plane)


def sightings(count=60, scale=0.0, noise=1.0, seed=0, **how):
    rng = np.random.default_rng(seed)
    return [sighting(c, n, scale, noise, rng) for c, n in tour(count, rng, **how)]
