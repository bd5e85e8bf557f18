"""A small renderer of the target, by supersampling; shares no code with the localiser."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from target_pose.target import Shade, Target

BLACK, WHITE, WALL = 30.0, 215.0, 120.0


@dataclass(frozen=True, slots=True)
class Look:
    """What stands between the world and the picture."""

    supersample: int = 5
    blur_px: float = 0.7
    motion_px: float = 0.0
    noise: float = 0.0
    gamma: float = 1.0
    jpeg_quality: int | None = None
    dim: float = 1.0
    wall_gap_m: float = 0.3
    wall: float = WALL


def facing_pose(center, tilt_rad=0.0, tilt_azimuth_rad=0.0, roll_rad=0.0):
    """``camera_from_target`` of a board tilted away from the line of sight to its centre."""
    center = np.asarray(center, dtype=float)
    to_camera = -center / np.linalg.norm(center)
    right = np.cross(to_camera, [0.0, -1.0, 0.0])
    right /= -np.linalg.norm(right)
    up = -np.cross(to_camera, right)
    sideways = np.cos(tilt_azimuth_rad) * right + np.sin(tilt_azimuth_rad) * up
    x = np.cos(tilt_rad) * to_camera + np.sin(tilt_rad) * sideways
    z = np.array([0.0, -1.0, 0.0])
    z -= x * (x @ z)
    z /= np.linalg.norm(z)
    y = np.cross(z, x)
    z, y = (
        np.cos(roll_rad) * z + np.sin(roll_rad) * y,
        np.cos(roll_rad) * y - np.sin(roll_rad) * z,
    )
    return Pose.from_rotation(np.column_stack([x, y, z]), center)


def true_box(target: Target, pose: Pose, intrinsics: CameraIntrinsics, side_m: float, square: bool):
    """x0, y0, x1, y1 of a printed square or disc."""
    a = np.linspace(0, 2 * np.pi, 361)
    y, z = np.cos(a), np.sin(a)
    if square:
        grow = 1 / np.maximum(np.abs(y), np.abs(z))
        y, z = y * grow, z * grow
    points = pose @ (np.stack([0 * a, y, z], axis=-1) * side_m / 2)
    uv = seen_pixels(points, intrinsics)
    return (*uv.min(axis=0), *uv.max(axis=0))


def seen_pixels(points, intrinsics: CameraIntrinsics):
    """Pixels (N, 2) of points (N, 3) by OpenCV, or for the inverse model by fixed-point steps."""
    k, c = intrinsics.image_from_camera, np.array(intrinsics.coefficients)
    if intrinsics.model == "brown_conrady":
        return cv2.projectPoints(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), k, c)[0][:, 0]
    xy = points[:, :2] / points[:, 2:]
    if intrinsics.model == "inverse_brown_conrady":
        seen = xy.copy()
        for _ in range(30):
            seen += xy - _polynomial(seen, c)
        xy = seen
    return xy * [k[0, 0], k[1, 1]] + [k[0, 2], k[1, 2]]


def rays(uv, intrinsics: CameraIntrinsics):
    """Rays (N, 3) with z = 1 of pixels (N, 2)."""
    k, c = intrinsics.image_from_camera, np.array(intrinsics.coefficients)
    if intrinsics.model == "brown_conrady":
        xy = cv2.undistortPoints(
            uv.reshape(-1, 1, 2), k, c, criteria=(cv2.TERM_CRITERIA_MAX_ITER, 50, 0)
        )[:, 0]
    else:
        xy = (uv - [k[0, 2], k[1, 2]]) / [k[0, 0], k[1, 1]]
        if intrinsics.model == "inverse_brown_conrady":
            xy = _polynomial(xy, c)
    return np.column_stack([xy, np.ones(len(xy))])


def _polynomial(xy, c):
    x, y = xy.T
    r2 = x * x + y * y
    f = 1 + c[0] * r2 + c[1] * r2**2 + c[4] * r2**3
    return np.column_stack(
        [
            x * f + 2 * c[2] * x * y + c[3] * (r2 + 2 * x * x),
            y * f + 2 * c[3] * x * y + c[2] * (r2 + 2 * y * y),
        ]
    )


def _cast(uv, intrinsics, pose: Pose, target: Target):
    """Board coordinates (N, 2), depth on the board's plane (N,), and whether the board is hit."""
    d = rays(uv, intrinsics)
    n, c = pose.rotation[:, 0], pose.translation
    with np.errstate(all="ignore"):
        z = (n @ c) / (d @ n)
    p = (d * z[:, None] - c) @ pose.rotation[:, 1:]
    hit = (z > 0) & (np.abs(p).max(axis=1) <= target.board_side_m / 2)
    return p, z, hit


def render_color(target: Target, intrinsics: CameraIntrinsics, pose: Pose, look=None, rng=None):
    """The picture (H, W, 3) uint8."""
    look = look or Look()
    s, w, h = look.supersample, intrinsics.width, intrinsics.height
    picture = np.full((h, w), look.wall)
    box = true_box(target, pose, intrinsics, target.board_side_m, square=True)
    margin = 4 * look.blur_px + look.motion_px + 3
    x0, y0 = (int(max(0, np.floor(v - margin))) for v in box[:2])
    x1, y1 = (int(min(m, np.ceil(v + margin))) for v, m in zip(box[2:], (w, h), strict=True))
    if x1 > x0 and y1 > y0:
        u = x0 - 0.5 + (np.arange((x1 - x0) * s) + 0.5) / s
        v = y0 - 0.5 + (np.arange((y1 - y0) * s) + 0.5) / s
        uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        p, _, hit = _cast(uv, intrinsics, pose, target)
        tone = {Shade.BLACK: BLACK, Shade.WHITE: WHITE}
        fine = np.where(hit, tone[target.board_shade], look.wall)
        radius = np.hypot(*p.T)
        for disc in target.discs:
            fine[hit & (radius <= disc.diameter_m / 2)] = tone[disc.shade]
        fine = fine.reshape(len(v), len(u))
        if look.blur_px:
            fine = cv2.GaussianBlur(fine, (0, 0), look.blur_px * s, borderType=cv2.BORDER_REPLICATE)
        if look.motion_px:
            kernel = np.ones((1, 2 * int(look.motion_px * s / 2) + 1))
            fine = cv2.filter2D(fine, -1, kernel / kernel.size, borderType=cv2.BORDER_REPLICATE)
        picture[y0:y1, x0:x1] = fine.reshape(y1 - y0, s, x1 - x0, s).mean(axis=(1, 3))
    picture = 255 * (picture * look.dim / 255) ** (1 / look.gamma)
    if look.noise:
        picture = picture + rng.normal(0, look.noise, picture.shape)
    color = np.repeat(np.clip(np.round(picture), 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    if look.jpeg_quality is not None:
        ok, data = cv2.imencode(".jpg", color, [cv2.IMWRITE_JPEG_QUALITY, look.jpeg_quality])
        assert ok
        color = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return color


def render_depth(target: Target, camera: RgbdCamera, pose: Pose, look=None, rng=None, **sensor):
    """Raw depth (h, w) uint16: board and a parallel wall behind it, with stereo's errors.

    ``sensor``: noise (sigma_z = noise z^2), holes (share), bias (relative), smooth_px.
    """
    look = look or Look()
    i = camera.depth
    u, v = np.meshgrid(np.arange(i.width, dtype=float), np.arange(i.height, dtype=float))
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    depth_from_target = camera.color_from_depth.inverse() @ pose
    _, z, hit = _cast(uv, i, depth_from_target, target)
    wall = depth_from_target @ Pose(
        np.array([-look.wall_gap_m, 0, 0]), np.array([1.0, 0.0, 0.0, 0.0])
    )
    z = np.where(hit, z, _cast(uv, i, wall, target)[1])
    z = np.where(z > 0, z, 0).reshape(i.height, i.width) * (1 + sensor.get("bias", 0.0))
    if noise := sensor.get("noise", 0.0):
        error = rng.normal(0, 1, z.shape)
        if smooth := sensor.get("smooth_px", 0.0):
            error = cv2.GaussianBlur(error, (0, 0), smooth)
            error /= error.std()
        z = z + noise * z * z * error
    if holes := sensor.get("holes", 0.0):
        blotch = cv2.GaussianBlur(rng.normal(0, 1, z.shape), (0, 0), 4)
        z = np.where(blotch < np.quantile(blotch, holes), 0, z)
    return np.clip(np.round(z / camera.depth_scale_m), 0, 65535).astype(np.uint16)
