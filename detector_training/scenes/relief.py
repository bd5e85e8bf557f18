"""Prints that are not flat: bent around a pipe, creased, crumpled, with a corner that peels off.

A relief moves each point of the sheet out of the board's plane and, where it bends, within it. What
the camera then sees equals a flat texture whose points are shifted along the lines of sight, so the
picture needs no mesh: the shifted texture is hung where the flat one would be. The labels are those
of the moved points, projected.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import Mask, smooth_noise
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Array, Pose

GROWTH = 1.25
"""Side of the shifted texture over the flat one's: a bent sheet may reach over its outline."""

_STEPS = 6
"""Of the fixed-point iteration that looks up where a seen point lies on the sheet."""

Surface: TypeAlias = Callable[[Array], Array]
"""Points (..., 2) of the flat sheet as (y, z) [m] to (..., 3) in the target's frame [m]."""


@dataclass(frozen=True, slots=True)
class Relief:
    """The shape of a sheet, and the direction of the light that shades it."""

    surface: Surface
    light: tuple[float, float, float]
    """Towards the lamp, target frame."""

    def outline(self, points: Array, camera: CameraIntrinsics, camera_from_target: Pose) -> Array:
        """Pixels (N, 2) of points (N, 2) of the sheet."""
        p = (camera_from_target @ self.surface(points)) @ camera.image_from_camera.T
        return np.asarray(p[:, :2] / p[:, 2:])


def random_relief(rng: np.random.Generator, side_m: float) -> Relief:
    """A bend, a crease, crumples or a peeling corner."""
    shapes = (_bent, _creased, _crumpled, _peeling)
    shape = shapes[int(rng.choice(len(shapes), p=(0.35, 0.2, 0.3, 0.15)))]
    light = np.array([rng.uniform(0.6, 1.5), *rng.normal(0, 0.7, 2)])
    return Relief(shape(rng, side_m), tuple((light / np.linalg.norm(light)).tolist()))


def shifted(
    texture: NDArray[np.float32], side_m: float, relief: Relief, camera_from_target: Pose
) -> NDArray[np.float32]:
    """The texture (N, N, 4) as it would have to be printed flat to look like the bent sheet.

    Returns:
        (N', N', 4), premultiplied, of ``GROWTH * side_m``; transparent where no sheet is seen.
    """
    n = texture.shape[0]
    m = round(n * GROWTH)
    coarse = max(33, min(m, 97))
    c = (np.arange(coarse) + 0.5) / coarse - 0.5
    seen = np.stack(np.meshgrid(c, -c), -1) * GROWTH * side_m  # (y, z) of columns and rows
    sheet = sheet_of(relief, seen, camera_from_target.inverse().translation)
    shade = _shade(relief, sheet)
    column = (sheet[..., 0] / side_m + 0.5) * n - 0.5
    row = (0.5 - sheet[..., 1] / side_m) * n - 0.5
    size = (m, m)
    maps = [np.asarray(cv2.resize(x.astype(np.float32), size)) for x in (column, row, shade)]
    moved = cv2.remap(texture, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    moved[..., :3] *= maps[2][..., None]
    return np.asarray(moved)


def sheet_of(relief: Relief, seen: Array, eye: Array) -> Array:
    """Which points (..., 2) of the sheet are seen in front of points (..., 2) of the plane.

    Args:
        relief: the shape of the sheet.
        seen: where the lines of sight meet the plane x = 0, as (y, z) [m].
        eye: (3,), in the target's frame [m].
    """
    sheet = seen.copy()
    for _ in range(_STEPS):
        sheet += 0.8 * (seen - _seen_at(relief.surface(sheet), eye))
    return sheet


def _seen_at(points: Array, eye: Array) -> Array:
    """Where the lines of sight to points (..., 3) meet the plane x = 0, (..., 2)."""
    share = eye[0] / np.maximum(eye[0] - points[..., :1], 1e-3)
    return np.asarray(eye[1:] + share * (points[..., 1:] - eye[1:]))


def _shade(relief: Relief, sheet: Array) -> Mask:
    """Lambert's cosine over its value on the flat board, (M, M)."""
    step = 1e-3
    here = relief.surface(sheet)
    along_y = relief.surface(sheet + (step, 0)) - here
    along_z = relief.surface(sheet + (0, step)) - here
    normal = np.cross(along_y, along_z)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    cosine = np.clip(normal @ np.asarray(relief.light), 0, None) / relief.light[0]
    return np.asarray(np.clip(0.35 + 0.65 * cosine, 0.2, 1.8), dtype=np.float32)


def _bent(rng: np.random.Generator, side_m: float) -> Surface:
    """Around a pipe or into a hollow, about any axis."""
    radius = side_m * math.exp(rng.uniform(math.log(0.7), math.log(3.5)))
    sign = 1.0 if rng.random() < 0.3 else -1.0
    angle = rng.uniform(0, math.pi)
    across = np.array([math.cos(angle), math.sin(angle)])

    def surface(p: Array) -> Array:
        s = p @ across
        turn = np.clip(s / radius, -1.4, 1.4)
        moved = p + ((radius * np.sin(turn) - s)[..., None]) * across
        return np.concatenate([(sign * radius * (1 - np.cos(turn)))[..., None], moved], -1)

    return surface


def _creased(rng: np.random.Generator, side_m: float) -> Surface:
    """Folded once or twice and flattened again."""
    folds = []
    for _ in range(int(rng.integers(1, 4))):
        angle = rng.uniform(0, math.pi)
        folds.append(
            (
                np.array([math.cos(angle), math.sin(angle)]),
                rng.uniform(-0.3, 0.3) * side_m,
                rng.normal(0, 0.16),
            )
        )

    def surface(p: Array) -> Array:
        out = sum(slope * np.abs(p @ across - at) for across, at, slope in folds)
        return np.concatenate([np.asarray(out)[..., None], p], -1)

    return surface


def _crumpled(rng: np.random.Generator, side_m: float) -> Surface:
    """Waves and dents of a few millimetres to two centimetres."""
    cells = int(rng.integers(2, 7))
    height = side_m * rng.uniform(0.01, 0.05) * 3 / (cells + 1)
    field = height * smooth_noise(rng, 64, 64, cells)

    def surface(p: Array) -> Array:
        at = np.clip((p / (1.6 * side_m) + 0.5) * 63, 0, 63).astype(np.float32)
        flat = at.reshape(1, -1, 2)
        out = np.concatenate(
            [
                cv2.remap(field, part[..., 0], part[..., 1], cv2.INTER_LINEAR)
                for part in np.array_split(flat, max(1, flat.shape[1] // 16384 + 1), axis=1)
            ],
            axis=1,
        )
        return np.concatenate([out.reshape(*p.shape[:-1], 1), p], -1)

    return surface


def _peeling(rng: np.random.Generator, side_m: float) -> Surface:
    """A corner or an edge that comes off the wall."""
    angle = rng.uniform(0, 2 * math.pi)
    towards = np.array([math.cos(angle), math.sin(angle)])
    start, curl = rng.uniform(0.0, 0.4) * side_m, rng.uniform(0.5, 2.5) / side_m

    def surface(p: Array) -> Array:
        beyond = np.clip(p @ towards - start, 0, 0.6 * side_m)
        return np.concatenate([(curl * beyond**2)[..., None], p], -1)

    return surface
