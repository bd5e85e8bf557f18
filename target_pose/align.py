"""Raw depth moved onto the colour camera: the points behind a box, or the whole picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import RgbdCamera
from target_pose.candidate import Box
from target_pose.lens import pixels_from_rays, rays_from_pixels

Array: TypeAlias = NDArray[np.float64]

NEAREST_M = 0.15
FARTHEST_M = 20.0
"""Depths outside of this are no measurements."""
MAX_SCANNED = 16_000
"""Depth pixels looked at per box; a larger region is looked at on a coarser raster."""
SEARCH_MARGIN_PX = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class DepthPoints:
    """Depth measurements that fall into a box of the colour picture."""

    points: Array  # (N, 3) [m]
    """In the colour camera's frame."""
    uv_px: Array  # (N, 2)
    """Their colour pixels."""


def depth_points_in_box(
    depth_units: NDArray[np.uint16], camera: RgbdCamera, box: Box, max_points: int = 1200
) -> DepthPoints:
    """Depth points (colour camera frame) that the colour camera sees inside a box.

    Only that region of the depth picture (h, w) is deprojected which can fall into the box at any
    depth from 0.15 to 20 m. What one of the cameras sees and the other does not is not sorted out.

    Returns:
        At most ``max_points`` points, spread evenly; none when there is no depth there.
    """
    region = _region(camera, box, depth_units.shape)
    if region is None:
        return _NO_POINTS
    x0, y0, x1, y1 = region
    stride = max(1, math.ceil(math.sqrt((x1 - x0) * (y1 - y0) / MAX_SCANNED)))
    patch = depth_units[y0:y1:stride, x0:x1:stride]
    measured = np.flatnonzero(patch)
    if camera.aligned:
        # all of them are in the box: no need to look at more than are wanted
        measured = _thinned(measured, max_points)
    if not len(measured):
        return _NO_POINTS
    rows, columns = np.divmod(measured, patch.shape[1])
    z = patch[rows, columns] * np.float64(camera.depth_scale_m)
    uv = np.stack([x0 + columns * stride, y0 + rows * stride], axis=1).astype(np.float64)
    points, uv = _to_color(uv, z, camera)
    inside = (uv[:, 0] >= box.x0) & (uv[:, 0] <= box.x1)
    inside &= (uv[:, 1] >= box.y0) & (uv[:, 1] <= box.y1)
    kept = _thinned(np.flatnonzero(inside), max_points)
    return DepthPoints(points[kept], uv[kept])


def _thinned(index: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """At most ``count`` of the indices (N,), spread evenly.

    By an uneven step: an even one through row-major order may fall on a few columns alone.
    """
    if len(index) <= count:
        return index
    return index[(np.arange(count) * (len(index) / count)).astype(np.intp)]


def align_depth(depth_units: NDArray[np.uint16], camera: RgbdCamera) -> NDArray[np.float32]:
    """The depth picture (h, w) as the colour camera would have it, (H, W) [m]; 0: no depth.

    Every depth pixel goes to the nearest colour pixel; where several meet, the nearest one to the
    camera stays. Where colour has the finer raster there are gaps between them.
    """
    color = camera.color
    aligned = np.full(color.height * color.width, np.inf, dtype=np.float64)
    rows, columns = np.nonzero(depth_units)
    z = depth_units[rows, columns] * np.float64(camera.depth_scale_m)
    points, uv = _to_color(np.stack([columns, rows], axis=1).astype(np.float64), z, camera)
    uv = np.floor(uv + 0.5)
    inside = (uv[:, 0] >= 0) & (uv[:, 0] < color.width)
    inside &= (uv[:, 1] >= 0) & (uv[:, 1] < color.height)
    at = (uv[inside, 1] * color.width + uv[inside, 0]).astype(np.intp)
    np.minimum.at(aligned, at, points[inside, 2])
    aligned[~np.isfinite(aligned)] = 0.0
    return aligned.reshape(color.height, color.width).astype(np.float32)


def _to_color(uv_depth: Array, z: Array, camera: RgbdCamera) -> tuple[Array, Array]:
    """Points (M, 3) and colour pixels (M, 2) of depth pixels (N, 2) that are measurements."""
    xy = rays_from_pixels(uv_depth, camera.depth)
    points = np.column_stack([xy * z[:, None], z])
    if not camera.aligned:
        points = camera.color_from_depth @ points
    real = np.isfinite(points).all(axis=1) & (z >= NEAREST_M) & (z <= FARTHEST_M)
    real &= points[:, 2] >= 0.5 * NEAREST_M
    points = points[real]
    if camera.aligned:
        return points, uv_depth[real]
    uv = pixels_from_rays(points[:, :2] / points[:, 2:], camera.color)
    seen = np.isfinite(uv).all(axis=1)
    return points[seen], uv[seen]


def _region(
    camera: RgbdCamera, box: Box, shape: tuple[int, ...]
) -> tuple[int, int, int, int] | None:
    """Depth pixels x0, y0, x1, y1 (half open) that may fall into the box.

    The box's outline is sent into the depth picture at the least and the greatest depth: a ray
    projects to a straight line but for lens distortion, which the margin covers.
    """
    height, width = shape
    corners = np.array([[box.x0, box.y0], [box.x1, box.y1]])
    if not np.isfinite(corners).all():
        return None
    if camera.aligned:
        low, high = np.floor(corners[0]), np.ceil(corners[1]) + 1
    else:
        low, high = _searched(camera, box)
    x0, y0 = (int(v) for v in np.clip(low, 0, (width, height)))
    x1, y1 = (int(v) for v in np.clip(high, 0, (width, height)))
    return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None


def _searched(camera: RgbdCamera, box: Box) -> tuple[Array, Array]:
    everything = np.zeros(2), np.array([camera.depth.width, camera.depth.height], dtype=float)
    clipped = np.clip(
        [[box.x0, box.y0], [box.x1, box.y1]],
        0,
        (camera.color.width - 1, camera.color.height - 1),
    )
    part = np.linspace(0, 1, 5)
    u = clipped[0, 0] + part * (clipped[1, 0] - clipped[0, 0])
    v = clipped[0, 1] + part * (clipped[1, 1] - clipped[0, 1])
    outline = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    xy = rays_from_pixels(outline, camera.color)
    depth_from_color = camera.color_from_depth.inverse()
    spots = []
    for z in (NEAREST_M, FARTHEST_M):
        points = depth_from_color @ np.column_stack([xy * z, np.full(len(xy), z)])
        if not (np.isfinite(points).all() and (points[:, 2] > 0.01).all()):
            return everything
        spots.append(pixels_from_rays(points[:, :2] / points[:, 2:], camera.depth))
    uv = np.concatenate(spots)
    if not np.isfinite(uv).all():
        return everything
    return np.floor(uv.min(axis=0) - SEARCH_MARGIN_PX), np.ceil(uv.max(axis=0) + SEARCH_MARGIN_PX)


_NO_POINTS = DepthPoints(np.empty((0, 3)), np.empty((0, 2)))
