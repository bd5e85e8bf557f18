"""A room of boxes, seen exactly: which surface each ray meets, where on it, and how far away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose


@dataclass(frozen=True, slots=True)
class Box:
    """An axis-aligned box in the world; a room is a box that is seen from the inside."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Hits:
    """What the ray of each pixel meets first."""

    depth_m: NDArray[np.float32]  # (H, W), along the optical axis
    box: NDArray[np.int16]  # (H, W), 0 is the room
    face: NDArray[np.int8]  # (H, W), 2 * axis + (1 on the high side)
    uv_m: NDArray[np.float32]  # (H, W, 2), place on the face
    cosine: NDArray[np.float32]  # (H, W), between ray and normal


def pixel_rays(camera: CameraIntrinsics, supersampling: int = 1) -> NDArray[np.float32]:
    """Rays (H*s, W*s, 3) of unit depth in the camera frame through the finer samples."""
    s = supersampling
    u = (np.arange(camera.width * s, dtype=np.float32) + 0.5) / s - 0.5
    v = (np.arange(camera.height * s, dtype=np.float32) + 0.5) / s - 0.5
    rays = np.empty((camera.height * s, camera.width * s, 3), dtype=np.float32)
    rays[..., 0] = ((u - camera.cx) / camera.fx)[None, :]
    rays[..., 1] = ((v - camera.cy) / camera.fy)[:, None]
    rays[..., 2] = 1.0
    return rays


def cast(
    rays_camera: NDArray[np.float32], world_from_camera: Pose, room: Box, boxes: tuple[Box, ...]
) -> Hits:
    """First hits of rays (H, W, 3) of unit depth from inside ``room`` (slab method).

    T. L. Kay, J. T. Kajiya, "Ray tracing complex scenes", 1986. As the rays have unit depth, the
    ray parameter is the depth itself.
    """
    origin = world_from_camera.translation.astype(np.float32)
    directions = rays_camera @ world_from_camera.rotation.T.astype(np.float32)
    directions = np.where(np.abs(directions) < 1e-9, np.float32(1e-9), directions)
    inverse = [np.ascontiguousarray(1.0 / directions[..., k]) for k in range(3)]

    def slabs(box: Box) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
        near, far = [], []
        for k in range(3):
            a = (np.float32(box.low[k]) - origin[k]) * inverse[k]
            b = (np.float32(box.high[k]) - origin[k]) * inverse[k]
            near.append(np.minimum(a, b))
            far.append(np.maximum(a, b))
        return near, far

    _, far = slabs(room)
    depth = np.minimum(np.minimum(far[0], far[1]), far[2])
    axis = _axis_of(depth, far)
    inside_out = np.ones(depth.shape, dtype=bool)
    index = np.zeros(depth.shape, dtype=np.int16)
    for i, box in enumerate(boxes, start=1):
        near, far = slabs(box)
        enter = np.maximum(np.maximum(near[0], near[1]), near[2])
        leave = np.minimum(np.minimum(far[0], far[1]), far[2])
        hit = (enter < leave) & (enter > 0.05) & (enter < depth)
        if not hit.any():
            continue
        depth = np.where(hit, enter, depth)
        axis = np.where(hit, _axis_of(enter, near), axis)
        index[hit] = i
        inside_out &= ~hit
    along = np.take_along_axis(directions, axis[..., None].astype(np.int64), -1)[..., 0]
    # from the inside a ray that goes up in the axis meets the high face, from the outside the low
    high = (along > 0) == inside_out
    points = origin + depth[..., None] * directions
    first = np.where(axis == 0, 1, 0)[..., None]
    second = np.where(axis == 2, 1, 2)[..., None]
    uv = np.concatenate(
        [np.take_along_axis(points, first, -1), np.take_along_axis(points, second, -1)], -1
    )
    cosine = np.abs(along) / np.linalg.norm(directions, axis=-1)
    face = (2 * axis + high).astype(np.int8)
    return Hits(
        depth.astype(np.float32),
        index,
        face,
        uv.astype(np.float32),
        cosine.astype(np.float32),
    )


def world_points(
    rays_camera: NDArray[np.float32], world_from_camera: Pose, hits: Hits
) -> NDArray[np.float32]:
    """Where the rays hit (H, W, 3) [m] in the world."""
    p = rays_camera * hits.depth_m[..., None]
    r = world_from_camera.rotation.T.astype(np.float32)
    return np.asarray(p @ r + world_from_camera.translation.astype(np.float32), dtype=np.float32)


def _axis_of(extreme: NDArray[np.float32], by_axis: list[NDArray[np.float32]]) -> NDArray[np.int8]:
    """Which of three arrays (H, W) holds their minimum or maximum."""
    return np.where(extreme == by_axis[0], 0, np.where(extreme == by_axis[1], 1, 2)).astype(np.int8)
