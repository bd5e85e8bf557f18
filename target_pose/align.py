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
MAX_SCANNED = 12_000
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
    """Depth points (colour camera frame) that fall into a box of the colour picture.

    Only that region of the depth picture (h, w) is deprojected which can fall into the box at any
    depth from 0.15 to 20 m. What one of the cameras sees and the other does not is not sorted out.

    Returns:
        At most ``max_points`` points, spread evenly; none when there is no depth there.
    """
    rays = rays_from_pixels(_raster(box, camera), camera.color)
    region = _region(camera, box, rays, depth_units.shape)
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
    if camera.aligned:
        points, uv = _measured(uv, z, camera)
    else:
        points = _near_rays(_measured(uv, z, camera)[0], rays, camera)
        points = points[_thinned(np.arange(len(points)), max_points)]
        points, uv = _seen(points, camera)
    low, high = _in_picture(box, camera)
    inside = _inside(uv, low, high)
    kept = _thinned(np.flatnonzero(inside), max_points)
    return DepthPoints(points[kept], uv[kept])


def depth_points_in_ellipse(
    depth_units: NDArray[np.uint16],
    camera: RgbdCamera,
    center_px: tuple[float, float],
    semi_axes_px: tuple[float, float],
) -> Array:
    """Depth points (N, 3), colour camera frame, in an upright ellipse of the colour picture."""
    (u, v), (a, b) = center_px, semi_axes_px
    found = depth_points_in_box(depth_units, camera, Box(u - a, v - b, u + a, v + b, 0.0))
    inside = np.square((found.uv_px - (u, v)) / (a, b)).sum(axis=1) < 1
    return np.asarray(found.points[inside])


def _near_rays(points: Array, rays: Array, camera: RgbdCamera) -> Array:
    """The points (M, 3) of (N, 3) that lie about within the rays (25, 2) of a box.

    Looks at rays and not at pixels, since the way through a lens to a pixel is the costly one.
    """
    if not np.isfinite(rays).all():
        return points
    low, high = rays.min(axis=0), rays.max(axis=0)
    # between the raster's points a distorted side bulges by less than this
    margin = 0.05 * (high - low) + SEARCH_MARGIN_PX / camera.color.fx
    return points[_inside(points[:, :2] / points[:, 2:], low - margin, high + margin)]


def _inside(xy: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Which of the points (N, 2) lie in a box; by columns, for short rows are slow to reduce."""
    x, y = xy[:, 0], xy[:, 1]
    inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    return np.asarray(inside)


def _in_picture(box: Box, camera: RgbdCamera) -> tuple[Array, Array]:
    """The corners (2,) of the part of a box that lies in the colour picture."""
    end = np.array([camera.color.width, camera.color.height]) - 0.5
    return np.clip((box.x0, box.y0), -0.5, end), np.clip((box.x1, box.y1), -0.5, end)


def _raster(box: Box, camera: RgbdCamera) -> Array:
    """Pixels (25, 2) spread over the part of a box that lies in the colour picture."""
    (x0, y0), (x1, y1) = (corner.tolist() for corner in _in_picture(box, camera))
    part = np.linspace(0, 1, 5)
    raster = np.meshgrid(x0 + part * (x1 - x0), y0 + part * (y1 - y0))
    return np.stack(raster, axis=-1).reshape(-1, 2)


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
    uv = np.stack([columns, rows], axis=1).astype(np.float64)
    points, uv = _measured(uv, z, camera)
    if not camera.aligned:
        points, uv = _seen(points, camera)
    uv = np.floor(uv + 0.5)
    inside = (uv[:, 0] >= 0) & (uv[:, 0] < color.width)
    inside &= (uv[:, 1] >= 0) & (uv[:, 1] < color.height)
    at = (uv[inside, 1] * color.width + uv[inside, 0]).astype(np.intp)
    np.minimum.at(aligned, at, points[inside, 2])
    aligned[~np.isfinite(aligned)] = 0.0
    return aligned.reshape(color.height, color.width).astype(np.float32)


def _measured(uv_depth: Array, z: Array, camera: RgbdCamera) -> tuple[Array, Array]:
    """Points (M, 3) in the colour frame, and their depth pixels, that are measurements."""
    real = (z >= NEAREST_M) & (z <= FARTHEST_M)
    uv_depth, z = uv_depth[real], z[real]
    xy = rays_from_pixels(uv_depth, camera.depth)
    points = np.empty((len(z), 3))
    np.multiply(xy, z[:, None], out=points[:, :2])
    points[:, 2] = z
    if not camera.aligned:
        points = camera.color_from_depth @ points
    # false for NaN, too, which a lens without inverse gives
    ahead = (points[:, 2] >= 0.5 * NEAREST_M) & (np.abs(points[:, 0] + points[:, 1]) < np.inf)
    return points[ahead], uv_depth[ahead]


def _seen(points: Array, camera: RgbdCamera) -> tuple[Array, Array]:
    """Those points (M, 3) of (N, 3) that have a colour pixel, and their pixels (M, 2)."""
    uv = pixels_from_rays(points[:, :2] / points[:, 2:], camera.color)
    seen = np.isfinite(uv).all(axis=1)
    return points[seen], uv[seen]


def _region(
    camera: RgbdCamera, box: Box, rays: Array, shape: tuple[int, ...]
) -> tuple[int, int, int, int] | None:
    """Depth pixels x0, y0, x1, y1 (half open) that may fall into the box.

    The box's ``rays`` (25, 2) are sent into the depth picture at the least and the greatest depth:
    a ray projects to a straight line but for lens distortion, which the margin covers.
    """
    height, width = shape
    corners = np.array([[box.x0, box.y0], [box.x1, box.y1]])
    if not np.isfinite(corners).all():
        return None
    if camera.aligned:
        low, high = np.floor(corners[0]), np.ceil(corners[1]) + 1
    else:
        low, high = _searched(camera, rays)
    x0, y0 = (int(v) for v in np.clip(low, 0, (width, height)))
    x1, y1 = (int(v) for v in np.clip(high, 0, (width, height)))
    return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None


def _searched(camera: RgbdCamera, rays: Array) -> tuple[Array, Array]:
    everything = np.zeros(2), np.array([camera.depth.width, camera.depth.height], dtype=float)
    ends = np.column_stack([rays, np.ones(len(rays))])
    ends = np.concatenate([NEAREST_M * ends, FARTHEST_M * ends])
    points = camera.color_from_depth.inverse() @ ends
    if not points[:, 2].min() > 0.01:  # true for NaN, too
        return everything
    uv = pixels_from_rays(points[:, :2] / points[:, 2:], camera.depth)
    if not np.isfinite(uv).all():
        return everything
    return np.floor(uv.min(axis=0) - SEARCH_MARGIN_PX), np.ceil(uv.max(axis=0) + SEARCH_MARGIN_PX)


_NO_POINTS = DepthPoints(np.empty((0, 3)), np.empty((0, 2)))
