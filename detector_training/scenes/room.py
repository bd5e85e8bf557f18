"""Furnished rooms: boxes with surfaces and a lamp, so that indoor views have real perspective."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import LinearImage
from detector_training.scenes.raycast import Box, Hits, cast, pixel_rays, world_points
from detector_training.scenes.surfaces import Surface
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose


@dataclass(frozen=True, slots=True)
class Room:
    """A box seen from the inside, boxes in it, and what covers their faces."""

    walls: Box
    furniture: tuple[Box, ...]
    surfaces: tuple[Surface, ...]
    """Tiled over the faces; box b, face f has ``covering[b][f]``."""
    covering: tuple[tuple[int, ...], ...]
    metres_per_tile: tuple[float, ...]
    """Of each surface."""
    lamp: tuple[float, float, float]
    """Where the lamp hangs, world [m]."""
    ambient: float
    """Light that comes from everywhere, as a share of the lamp's at 2 m."""


def random_room(rng: np.random.Generator, surfaces: tuple[Surface, ...]) -> Room:
    """A room of 3 to 8 m with up to nine boxes along the walls and in it."""
    w, d, h = rng.uniform(2.5, 8), rng.uniform(2.5, 8), rng.uniform(2.2, 3.5)
    boxes = []
    for _ in range(int(rng.integers(2, 10))):
        size = rng.uniform((0.2, 0.2, 0.1), (2.0, 1.0, 1.8))
        low = rng.uniform((-w / 2, -d / 2, 0), (w / 2, d / 2, 0.1))
        if rng.random() < 0.5:  # against a wall
            side = rng.random() < 0.5
            low[1] = d / 2 - size[1] if side else -d / 2
        if rng.random() < 0.5:
            low[2] = 0.0
        else:
            low[2] = rng.uniform(0.3, h)
        high = low + size
        boxes.append(Box(_three(low), _three(high)))
    kinds = len(surfaces)
    covering = [tuple(int(k) for k in rng.integers(0, kinds, 6))]
    for _ in boxes:
        one = int(rng.integers(kinds))
        mixed = rng.random() < 0.3
        covering.append(tuple(int(k) for k in rng.integers(0, kinds, 6)) if mixed else (one,) * 6)
    return Room(
        Box((-w / 2, -d / 2, 0.0), (w / 2, d / 2, h)),
        tuple(boxes),
        surfaces,
        tuple(covering),
        tuple(float(m) for m in rng.uniform(0.5, 3.0, kinds)),
        _three(rng.uniform((-w / 2, -d / 2, h * 0.6), (w / 2, d / 2, h))),
        float(rng.uniform(0.15, 1.0)),
    )


def random_view(rng: np.random.Generator, room: Room) -> Pose:
    """``world_from_camera`` inside the room, roughly level, looking across its longer way."""
    low, high = np.array(room.walls.low), np.array(room.walls.high)
    place = low + (high - low) * rng.uniform((0.1, 0.1, 0.3), (0.9, 0.9, 0.8))
    centre = (low + high) / 2
    towards = centre - place + rng.normal(0, 0.8, 3) * (1, 1, 0.3)
    towards[2] *= 0.5
    return looking(place, towards, float(rng.normal(0, 0.1)))


def looking(
    place: NDArray[np.float64], towards: NDArray[np.float64], roll_rad: float = 0.0
) -> Pose:
    """``world_from_camera`` at ``place`` with the optical axis along ``towards`` (not upright)."""
    z = towards / np.linalg.norm(towards)
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    rotation = np.column_stack([c * x + s * y, c * y - s * x, z])
    return Pose.from_rotation(rotation, np.asarray(place, dtype=np.float64))


def render(
    room: Room, camera: CameraIntrinsics, world_from_camera: Pose, supersampling: int = 1
) -> tuple[LinearImage, NDArray[np.float32], Hits]:
    """The room as the camera sees it, the light (H, W) that falls there, and what is hit.

    With supersampling the picture and the light are averaged over each pixel, the hits are not.
    """
    rays = pixel_rays(camera, supersampling)
    hits = cast(rays, world_from_camera, room.walls, room.furniture)
    points = world_points(rays, world_from_camera, hits)
    image = np.zeros((*hits.depth_m.shape, 3), dtype=np.float32)
    which = np.array(room.covering, dtype=np.int16)[hits.box, hits.face]
    for k, surface in enumerate(room.surfaces):
        seen = which == k
        if not seen.any():
            continue
        image[seen] = _tiled(surface, hits.uv_m / room.metres_per_tile[k], seen)
    light = light_at(room, points, hits.face)
    image *= light[..., None]
    if supersampling > 1:
        size = (camera.width, camera.height)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        light = np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA))
    return image, light, hits


def light_at(
    room: Room, points: NDArray[np.float32], face: NDArray[np.int8]
) -> NDArray[np.float32]:
    """Light (H, W) on points (H, W, 3) of axis-aligned faces: a lamp and the ambient."""
    to_lamp = np.asarray(room.lamp, dtype=np.float32) - points
    square = np.einsum("hwc,hwc->hw", to_lamp, to_lamp) + np.float32(0.3)
    along = np.take_along_axis(to_lamp, (face // 2)[..., None].astype(np.int64), -1)[..., 0]
    lamp = 4.0 * np.abs(along) / square**1.5
    return np.asarray(room.ambient + (1 - room.ambient) * np.minimum(lamp, 3.0), dtype=np.float32)


def _tiled(
    surface: Surface, uv: NDArray[np.float32], seen: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Samples (K, 3) of a surface repeated over ``uv`` (H, W, 2) where ``seen``.

    The surface is first shrunk to about the resolution at which it is seen: far walls would
    glitter otherwise.
    """
    n = surface.shape[0]
    du = np.abs(np.diff(uv[..., 0], axis=1)[seen[:, 1:]])
    dv = np.abs(np.diff(uv[..., 1], axis=0)[seen[1:, :]])
    step = max(float(np.median(du)) if du.size else 0.0, float(np.median(dv)) if dv.size else 0.0)
    wanted = int(np.clip(1 / max(step, 1e-6), 8, n))
    if wanted < n:
        surface = np.asarray(cv2.resize(surface, (wanted, wanted), interpolation=cv2.INTER_AREA))
    size = surface.shape[0]
    texel = np.mod(uv[seen] * size - 0.5, size).astype(np.float32)
    padded = cv2.copyMakeBorder(surface, 0, 1, 0, 1, cv2.BORDER_WRAP)
    # remap takes at most 32767 columns: fold the list of samples into rows
    count = len(texel)
    rows = -(-count // 16384)
    samples = np.zeros((rows * 16384, 2), dtype=np.float32)
    samples[:count] = texel
    grid = samples.reshape(rows, 16384, 2)
    sampled = cv2.remap(padded, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR)
    return np.asarray(sampled.reshape(-1, 3)[:count])


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
