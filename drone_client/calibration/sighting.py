"""One frame's two opinions on one target: the circles' in colour, the plane's in raw depth.

The plane is fitted in the depth camera's own frame, to the pixels that lie behind the printed disc.
So neither ``depth_scale_m`` nor ``color_from_depth`` has touched it before the two are compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import RgbdCamera
from rgbd_wire.geometry import Array, Pose
from target_pose.candidate import Candidate
from target_pose.lens import project, rays_from_pixels
from target_pose.localisation import Localisation, Method, Refusal
from target_pose.localise import localise
from target_pose.plane import InverseDepthPlane, fit_plane
from target_pose.residuals import spread
from target_pose.target import Target

DISC_SHARE: Final = 0.9
"""Part of the outer disc's radius within which depth is taken: its rim may fall off the board when
the cameras are not where the camera file says."""
MAX_PIXELS: Final = 4000
MIN_PIXELS: Final = 40
PLAUSIBLE_RATIO: Final = 1.15
"""Depth over circles past which it is a blunder; the localiser refuses such frames."""
NEAREST_M: Final = 0.05
RIM = 48


@dataclass(frozen=True, slots=True, eq=False)
class Circles:
    """The target as the picture alone has it, in the colour camera's frame."""

    center: Array  # (3,) [m]
    normal: Array  # (3,)
    """Unit, towards the camera."""
    range_sigma_m: float
    normal_sigma_rad: float

    @property
    def range_m(self) -> float:
        """Distance to the centre."""
        return math.sqrt(float(self.center @ self.center))

    @property
    def tilt_rad(self) -> float:
        """Angle between the normal and the line of sight."""
        return math.acos(min(max(-float(self.normal @ self.center) / self.range_m, -1.0), 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A target that was seen by both cameras."""

    name: str
    circles: Circles
    """In the fold that the depth prefers."""
    ratio: float
    """Raw depth over the depth that the circles predict, the median over the disc's pixels."""
    plane: InverseDepthPlane | None
    """In the depth camera's frame; None where depth is not even nearly the circles'."""


@dataclass(frozen=True, slots=True)
class Miss:
    """A frame that says nothing."""

    name: str
    reason: str


def sight(
    name: str,
    color_rgb: NDArray[np.uint8],
    depth_units: NDArray[np.uint16] | None,
    camera: RgbdCamera,
    candidate: Candidate,
    target: Target,
) -> Sighting | Miss:
    """Measure a target in both pictures, each by itself.

    Args:
        name: of the frame.
        color_rgb: (H, W, 3).
        depth_units: (h, w) raw depth, 0 for none; None: there is no depth picture.
        camera: The rig as the camera file has it.
        candidate: Where in the colour picture the target is.
        target: What was printed.
    """
    if depth_units is None:
        return Miss(name, "no depth picture")
    located = localise(color_rgb, None, camera, candidate, target)
    if isinstance(located, Refusal):
        return Miss(name, f"circles: {located.value}")
    if located.method is not Method.ELLIPSE:
        return Miss(name, "no circle to be seen")
    radius_m = DISC_SHARE * target.discs[0].diameter_m / 2
    pixels = _disc_pixels(depth_units, camera, located.camera_from_target, radius_m)
    if pixels is None:
        return Miss(name, "the depth camera does not see it whole")
    rays, z = pixels
    if len(z) < MIN_PIXELS:
        return Miss(name, "no depth on it")
    depth_from_color = camera.color_from_depth.inverse()
    first = circles_of(located, located.camera_from_target)
    ratio = _ratio(first, depth_from_color, rays, z)
    if ratio is None:
        return Miss(name, "the depth camera does not see it whole")
    if not 1 / PLAUSIBLE_RATIO < ratio < PLAUSIBLE_RATIO:
        return Sighting(name, first, ratio, None)
    plane = fit_plane(rays * z[:, None])
    if plane is None:
        return Miss(name, "its depth is no plane")
    return Sighting(
        name, _chosen_fold(located, first, plane, camera.color_from_depth), ratio, plane
    )


def circles_of(located: Localisation, pose: Pose) -> Circles:
    """What is needed of one fold."""
    s = spread(located)
    return Circles(pose.translation, pose.rotation[:, 0], s.range_m, s.normal_rad)


def _chosen_fold(
    located: Localisation, first: Circles, plane: InverseDepthPlane, color_from_depth: Pose
) -> Circles:
    """The fold whose normal is nearer to the plane's; circles alone may not know."""
    if located.alternative is None or not located.ambiguous:
        return first
    second = circles_of(located, located.alternative)
    normal = color_from_depth.rotation @ plane.normal
    return max(first, second, key=lambda c: float(c.normal @ normal))


def _disc_pixels(
    depth_units: NDArray[np.uint16], camera: RgbdCamera, pose: Pose, radius_m: float
) -> tuple[Array, Array] | None:
    """Rays (N, 3), z = 1, and depths (N,) [m] of the disc's pixels in the depth picture.

    Returns:
        None where the disc does not lie in the depth picture, or has under 40 pixels there.
    """
    angle = np.linspace(0, 2 * math.pi, RIM, endpoint=False)
    rim = radius_m * np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1)
    uv = project(camera.color_from_depth.inverse() @ (pose @ rim), camera.depth)
    height, width = depth_units.shape
    if not (np.isfinite(uv).all() and uv.min() > -0.5 and (uv < (width - 0.5, height - 0.5)).all()):
        return None
    (x0, y0), (x1, y1) = np.floor(uv.min(axis=0)).astype(int), np.ceil(uv.max(axis=0)).astype(int)
    x0, y0 = max(x0, 0), max(y0, 0)
    inside = np.zeros((min(y1, height - 1) - y0 + 1, min(x1, width - 1) - x0 + 1), np.uint8)
    cv2.fillPoly(inside, [np.round((uv - (x0, y0)) * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    patch = depth_units[y0 : y0 + inside.shape[0], x0 : x0 + inside.shape[1]]
    rows, columns = np.nonzero((inside > 0) & (patch > 0))
    if np.count_nonzero(inside) < MIN_PIXELS:
        return None
    if len(rows) > MAX_PIXELS:
        kept = (np.arange(MAX_PIXELS) * (len(rows) / MAX_PIXELS)).astype(np.intp)
        rows, columns = rows[kept], columns[kept]
    z = patch[rows, columns] * np.float64(camera.depth_scale_m)
    xy = rays_from_pixels(np.stack([x0 + columns, y0 + rows], axis=1).astype(float), camera.depth)
    known = np.isfinite(xy).all(axis=1)
    return np.column_stack([xy[known], np.ones(int(known.sum()))]), z[known]


def _ratio(circles: Circles, depth_from_color: Pose, rays: Array, z: Array) -> float | None:
    """Median of measured over predicted depth; None where the board is behind the depth camera."""
    center = depth_from_color @ circles.center
    normal = depth_from_color.rotation @ circles.normal
    predicted = float(normal @ center) / (rays @ normal)
    if not (center[2] > NEAREST_M and predicted.min() > 0):
        return None
    return float(np.median(z / predicted))
