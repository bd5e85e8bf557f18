"""What hangs in a scene: the target on its wall, and things that look like it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes import light
from detector_training.scenes.backdrop import Library, random_patch, random_wall
from detector_training.scenes.geometry import Flat
from detector_training.scenes.image import LinearImage, Mask
from detector_training.scenes.lookalikes import random_lookalike
from detector_training.scenes.placement import Placement, random_placement
from detector_training.scenes.printed import Paint, draw_target, random_paint, wear, with_alpha
from detector_training.scenes.projection import image_from_board, is_in_front, square_box
from detector_training.scenes.recipe import Plan
from detector_training.scenes.relief import GROWTH, Relief, shifted
from detector_training.scenes.warp import Layer, paste, texture_side_px, warp
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose.target import Target

Board: TypeAlias = Callable[[int, Paint], NDArray[np.float32]]
"""Draws a print of N texels in two paints as albedo (N, N, 3): another marker in the same place."""

LOOKALIKE_PX = (28.0, 330.0)
"""Smallest and largest side of a look-alike; smaller ones could not be told apart."""
MUCH_WORN = 0.5
"""Strength of wear from which on a picture counts as one of a scratched target."""


def hang_target(
    rng: np.random.Generator,
    image: LinearImage,
    library: Library,
    target: Target,
    camera: CameraIntrinsics,
    pose: Pose,
    shading: Mask,
    plan: Plan,
    relief: Relief | None,
    board: Board | None,
    conditions: list[str],
) -> Flat | None:
    """Lay the target over the picture in place, worn, lit and mirrored as the plan has it.

    Returns:
        Where it hangs; None when nothing of it falls in the picture.
    """
    h = image_from_board(camera, pose)
    side = target.board_side_m
    paint, texels = random_paint(rng), texture_side_px(h, side)
    albedo = draw_target(target, texels, paint) if board is None else board(texels, paint)
    probability, least, most = plan.worn
    if rng.random() < probability:
        strength = rng.uniform(least, most)
        wear(rng, albedo, strength)
        if strength > MUCH_WORN:
            conditions.append("scratched")
    texture = with_alpha(np.clip(albedo, 0, 1))
    if relief is not None:
        texture, side = shifted(texture, side, relief, pose), GROWTH * side
        conditions.append("distortion")
    layer = warp(texture, side, h, camera.width, camera.height)
    if layer is None:
        return None
    box = square_box(h, target.board_side_m)
    if rng.random() < 0.4:
        _contact_shadow(rng, image, layer, box)
    lamp = light.light_of_backdrop(rng, image, box)
    lit = lamp * shading[layer.window][..., None]
    paste(image, layer, lit)
    rows, columns = layer.window
    if rng.random() < plan.gloss:
        spot = light.gloss(rng, layer, box)
        image[rows, columns] += (spot * layer.alpha)[..., None] * lamp
        conditions.append("glossy")
    if rng.random() < plan.mirror:
        room = random_patch(rng, library.photos, layer.alpha.shape[1], layer.alpha.shape[0])
        strength = np.exp(rng.uniform(np.log(0.05), np.log(0.6)))
        image[rows, columns] += np.float32(strength) * layer.alpha[..., None] * room * lamp
        if strength > 0.15:
            conditions.append("glossy")
    return Flat(pose, layer)


def _contact_shadow(
    rng: np.random.Generator, image: LinearImage, layer: Layer, box: tuple[float, ...]
) -> None:
    """The board stands off the wall a little, so it throws a narrow shadow on it."""
    size = max(box[2] - box[0], box[3] - box[1])
    whole = np.zeros(image.shape[:2], dtype=np.float32)
    whole[layer.window] = layer.alpha
    shift = rng.normal(0, 0.03 * size, 2)
    moved = cv2.warpAffine(
        whole,
        np.array([[1, 0, shift[0]], [0, 1, shift[1]]]),
        (image.shape[1], image.shape[0]),
        borderMode=cv2.BORDER_REPLICATE,
    )
    soft = np.asarray(cv2.GaussianBlur(moved, (0, 0), float(np.clip(0.02 * size, 0.6, 8))))
    image *= 1 - rng.uniform(0.2, 0.8) * soft[..., None]


def hang_wall(
    rng: np.random.Generator,
    image: LinearImage,
    library: Library,
    camera: CameraIntrinsics,
    pose: Pose,
    shading: Mask,
) -> Flat | None:
    """A wall or a panel in the target's plane, behind it; None when it is not in the picture."""
    side = float(np.exp(rng.uniform(np.log(0.5), np.log(4.0))))
    offset = rng.uniform(-0.5, 0.5, 2) * max(0.0, side - 0.45)
    moved = Pose(
        pose.translation + pose.rotation[:, 1] * offset[0] + pose.rotation[:, 2] * offset[1],
        pose.q_wxyz,
    )
    if not is_in_front(moved, side):
        return None
    texture = with_alpha(random_wall(rng, library))
    layer = warp(texture, side, image_from_board(camera, moved), camera.width, camera.height)
    if layer is None:
        return None
    lamp = light.light_of_backdrop(rng, image, (0, 0, camera.width, camera.height))
    paste(image, layer, lamp * shading[layer.window][..., None])
    return Flat(moved, layer)


def hang_lookalike(
    rng: np.random.Generator,
    image: LinearImage,
    target: Target,
    camera: CameraIntrinsics,
    shading: Mask,
) -> Flat | None:
    """Something that is not the target, anywhere; None when it is not in the picture."""
    side = target.board_side_m
    pose = random_placement(rng, camera, side, Placement(LOOKALIKE_PX, cut=0.15, any_roll=0.1))
    h = image_from_board(camera, pose)
    texture = random_lookalike(rng, texture_side_px(h, side), target)
    if rng.random() < 0.3:
        worn = texture[..., :3].copy()
        wear(rng, worn, rng.uniform(0.1, 0.8))
        texture[..., :3] = np.clip(worn, 0, 1) * texture[..., 3:]
    layer = warp(texture, side, h, camera.width, camera.height)
    if layer is None:
        return None
    lamp = light.light_of_backdrop(rng, image, square_box(h, side))
    paste(image, layer, lamp * shading[layer.window][..., None])
    return Flat(pose, layer)
