"""Where the target's shapes fall in the image: exact boxes, areas and shares.

The board is flat, so a homography maps it. A circle's image is an ellipse, whose box follows from
its dual conic in closed form (R. Hartley, A. Zisserman, "Multiple View Geometry", 2nd ed., 2.2.3
and 8.3), with no sampling.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Array, Pose

MIN_DEPTH_M = 0.05
"""What comes nearer than this to the camera's plane has no usable image."""


def image_from_board(camera: CameraIntrinsics, camera_from_target: Pose) -> Array:
    """Homography (3, 3): board point (y, z, 1) [m] in the target frame to pixels."""
    r = camera_from_target.rotation
    plane = np.column_stack([r[:, 1], r[:, 2], camera_from_target.translation])
    return np.asarray(camera.image_from_camera @ plane)


def project(homography: Array, points: Array) -> Array:
    """Points (N, 2) through a homography, (N, 2)."""
    q = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(q[:, :2] / q[:, 2:])


def square_corners(side_m: float) -> Array:
    """Corners (4, 2) of a centred square on the board as (y, z) [m], in order around it."""
    h = side_m / 2
    return np.array([[-h, h], [h, h], [h, -h], [-h, -h]])


def square_points(side_m: float, per_side: int = 40) -> Array:
    """Points (4 * per_side, 2) around a centred square on the board [m]."""
    corners = square_corners(side_m)
    t = (np.arange(per_side) / per_side)[:, None]
    following = np.roll(corners, -1, axis=0)
    return np.concatenate([a + t * (b - a) for a, b in zip(corners, following, strict=True)])


def circle_points(radius_m: float, count: int = 360) -> Array:
    """Points (count, 2) around a centred circle on the board [m]."""
    angle = np.arange(count) * (2 * math.pi / count)
    return radius_m * np.column_stack([np.cos(angle), np.sin(angle)])


def is_in_front(camera_from_target: Pose, side_m: float) -> bool:
    """All corners of a square of this side lie in front of the camera, and its face is seen."""
    corners = square_corners(side_m)
    points = np.column_stack([np.zeros(4), corners])
    depth = (camera_from_target @ points)[:, 2]
    faces_us = camera_from_target.rotation[:, 0] @ camera_from_target.translation < 0
    return bool(depth.min() > MIN_DEPTH_M and faces_us)


def square_box(homography: Array, side_m: float) -> tuple[float, float, float, float]:
    """Box (x0, y0, x1, y1) [px] around the image of a centred square."""
    p = project(homography, square_corners(side_m))
    (x0, y0), (x1, y1) = p.min(0), p.max(0)
    return float(x0), float(y0), float(x1), float(y1)


def circle_box(homography: Array, radius_m: float) -> tuple[float, float, float, float]:
    """Box (x0, y0, x1, y1) [px] around the image of a centred circle.

    The tangent lines x = u of the image conic satisfy l' D l = 0 with D its dual conic.
    """
    dual = homography @ np.diag([radius_m**2, radius_m**2, -1.0]) @ homography.T

    def extent(i: int) -> tuple[float, float]:
        middle = dual[i, 2] / dual[2, 2]
        half = math.sqrt(dual[i, 2] ** 2 - dual[i, i] * dual[2, 2]) / abs(dual[2, 2])
        return middle - half, middle + half

    (x0, x1), (y0, y1) = extent(0), extent(1)
    return float(x0), float(y0), float(x1), float(y1)


def polygon_area(points: Array) -> float:
    """Area of a simple polygon (N, 2)."""
    if len(points) < 3:
        return 0.0
    x, y = points[:, 0], points[:, 1]
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def share_inside(points: Array, width: int, height: int) -> float:
    """Share of a convex polygon's area (N, 2) that lies inside the image."""
    whole = polygon_area(points)
    if whole <= 0:
        return 0.0
    clipped = points
    for axis, limit, sign in (
        (0, -0.5, 1),
        (0, width - 0.5, -1),
        (1, -0.5, 1),
        (1, height - 0.5, -1),
    ):
        clipped = _clip(clipped, axis, limit, sign)
    return min(1.0, polygon_area(clipped) / whole)


def _clip(points: Array, axis: int, limit: float, sign: int) -> NDArray[np.float64]:
    """One half-plane of Sutherland and Hodgman's clipping (1974): keep sign*(p - limit) >= 0."""
    kept: list[Array] = []
    distance = sign * (points[:, axis] - limit) if len(points) else np.empty(0)
    for i in range(len(points)):
        a, b, da, db = points[i - 1], points[i], distance[i - 1], distance[i]
        if (da >= 0) != (db >= 0):
            kept.append(a + (b - a) * (da / (da - db)))
        if db >= 0:
            kept.append(b)
    return np.array(kept).reshape(-1, 2)
