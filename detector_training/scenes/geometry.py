"""How far away everything in a scene is, told from how its picture was put together.

A picture fixes depth up to scale: a room twice as large, seen from twice as far, looks the same.
The target's size is known, so its distance is; what is behind it is scaled to be behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import Mask, cloud_noise
from detector_training.scenes.raycast import pixel_rays
from detector_training.scenes.relief import Relief, sheet_of
from detector_training.scenes.warp import Layer
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose

Depth = NDArray[np.float32]
"""(H, W) along the optical axis [m]; infinite where a thing is not."""

COVERED = 0.5
"""Share of a pixel from which on a thing is what its depth is of."""
GAP = 1.01
"""How much farther than the board what it hides must be."""
RELIEF_STEPS = 5
"""Of the distances in a photograph: things, not hills."""


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """A flat thing that was hung in the picture."""

    camera_from_plane: Pose
    """The plane is x = 0, as a target's."""
    layer: Layer


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Where the parts of a scene are, in the order in which they were painted."""

    camera: CameraIntrinsics
    backdrop_m: Depth | None
    """None: nobody knows."""
    backdrop_flat: bool
    """Whether that is one wall, seen head-on."""
    wall: Flat | None
    lookalikes: tuple[Flat, ...]
    board: Flat | None
    relief: Relief | None
    """Of the board."""
    in_front: tuple[Mask, ...]  # (H, W) each


def true_depth(rng: np.random.Generator, scene: Geometry) -> Depth:
    """Depth of each pixel, finite and positive.

    Exact on the board and its wall, and in a room but for its scale; plausible where the picture
    does not say: in photographs, for what hangs about and for what is in front.

    Args:
        rng: source of what the picture does not say.
        scene: where everything is.
    """
    rays = pixel_rays(scene.camera)
    depth = scene.backdrop_m
    if depth is None:
        depth = _guessed(rng, rays, scene.backdrop_flat)
    nothing = np.full(depth.shape, np.inf, dtype=np.float32)
    board = nothing if scene.board is None else _board(scene.board, scene.relief, rays)
    there = np.isfinite(board)
    if there.any():
        depth = depth * max(1.0, GAP * float((board[there] / depth[there]).max()))
    if scene.wall is not None:
        depth = _over(depth, _plane(scene.wall, rays))
    for thing in scene.lookalikes:
        own = _plane(thing, rays)
        hung = np.isfinite(own)
        behind_board = bool((own[hung & there] >= board[hung & there]).all())
        # what does not fit in between is a picture of itself, printed on what is behind
        if behind_board and (own <= depth)[hung].all():
            depth = _over(depth, own)
    depth = _over(depth, board)
    for cover in scene.in_front:
        hides = cover > COVERED
        if hides.any():
            near = rng.uniform(0.35, 0.9) * float(depth[hides].min())
            depth = np.where(hides, np.float32(near), depth)
    return np.asarray(depth, dtype=np.float32)


def _over(below: Depth, top: Depth) -> Depth:
    return np.where(np.isfinite(top), top, below)


def _plane(flat: Flat, rays: NDArray[np.float32]) -> Depth:
    """Depth of a flat thing where it covers the picture."""
    depth = np.full(rays.shape[:2], np.inf, dtype=np.float32)
    window = flat.layer.window
    normal = flat.camera_from_plane.rotation[:, 0]
    along = rays[window] @ normal
    distance = float(normal @ flat.camera_from_plane.translation)
    covered = (flat.layer.alpha > COVERED) & (along * distance > 0)
    depth[window][covered] = distance / along[covered]
    return depth


def _board(flat: Flat, relief: Relief | None, rays: NDArray[np.float32]) -> Depth:
    """Depth of the board, bent or not."""
    depth = _plane(flat, rays)
    if relief is None:
        return depth
    there = np.isfinite(depth)
    target_from_camera = flat.camera_from_plane.inverse()
    seen = target_from_camera @ (rays[there] * depth[there][:, None]).astype(np.float64)
    sheet = sheet_of(relief, seen[:, 1:], target_from_camera.translation)
    depth[there] = (flat.camera_from_plane @ relief.surface(sheet))[:, 2]
    return depth


def _guessed(rng: np.random.Generator, rays: NDArray[np.float32], flat: bool) -> Depth:
    """A wall, or what a photograph may show: ground that rises to far things, and near ones."""
    height, width = rays.shape[:2]
    middle_m = float(np.exp(rng.uniform(np.log(1.5), np.log(6.0))))
    if flat:
        return np.full((height, width), middle_m, dtype=np.float32)
    slant = 1 + rng.normal(0, 0.3) * rays[..., 0] + rng.uniform(0, 0.8) * rays[..., 1]
    things = cloud_noise(rng, height, width, int(rng.integers(2, 5)), 2)
    steps = np.rint(np.clip(things, -2, 2) * RELIEF_STEPS / 4) / RELIEF_STEPS
    return np.asarray(middle_m / np.clip(slant + steps, 0.2, 4.0), dtype=np.float32)
