"""One scene from one seed: a picture with a target or without, and the true boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes import light, occluders, sensor
from detector_training.scenes.backdrop import Library, random_backdrop, random_wall
from detector_training.scenes.image import LinearImage, Mask
from detector_training.scenes.lookalikes import random_lookalike
from detector_training.scenes.placement import random_camera, random_placement
from detector_training.scenes.printed import draw_target, random_paint, wear, with_alpha
from detector_training.scenes.projection import (
    circle_box,
    circle_points,
    image_from_board,
    is_in_front,
    project,
    share_inside,
    square_box,
    square_corners,
)
from detector_training.scenes.warp import Layer, paste, texture_side_px, warp
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Array, Pose
from target_pose.target import Level, Target

NEGATIVE_SHARE = 0.22
"""Share of pictures without a target."""
TARGET_PX = (9.0, 420.0)
"""Smallest and largest apparent diameter of the target's outer disc."""
LOOKALIKE_PX = (28.0, 330.0)
"""Smallest and largest side of a look-alike; smaller ones could not be told apart."""


@dataclass(frozen=True, slots=True)
class LabelledBox:
    """Where one level of the target truly is."""

    level: Level
    xyxy: tuple[float, float, float, float]
    """Around the projected shape, not clipped by the image [px]."""
    visible: float
    """Share of the shape's area that lies in the image and is not hidden, [0, 1]."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A labelled picture."""

    jpeg: bytes
    width: int
    height: int
    conditions: tuple[str, ...]
    boxes: tuple[LabelledBox, ...]
    """Empty for a negative."""
    camera: CameraIntrinsics
    camera_from_target: Pose | None

    def label(self, image: str) -> dict[str, Any]:
        """The line of ``labels.jsonl`` for the picture stored as ``image``."""
        distance = None
        if self.boxes and self.camera_from_target is not None:
            distance = round(float(np.linalg.norm(self.camera_from_target.translation)), 4)
        return {
            "image": image,
            "width": self.width,
            "height": self.height,
            "kind": "scene" if self.boxes else "negative",
            "conditions": list(self.conditions),
            "distance_m": distance,
            "boxes": [
                {
                    "level": str(b.level),
                    "xyxy": [round(v, 3) for v in b.xyxy],
                    "visible": round(b.visible, 4),
                }
                for b in self.boxes
            ],
        }


def generate(seed: tuple[int, ...], library: Library, target: Target) -> Scene:
    """The scene of a seed; the same bytes for the same seed and background files."""
    rng = np.random.default_rng(seed)
    camera = random_camera(rng)
    image = random_backdrop(rng, library, camera).copy()
    conditions: list[str] = []
    pose: Pose | None = None
    if rng.random() >= NEGATIVE_SHARE:
        pose = random_placement(
            rng, camera, target.board_side_m, target.discs[0].diameter_m, TARGET_PX
        )
    shading = light.shading(rng, camera.height, camera.width)
    if rng.random() < 0.4:
        image *= shading[..., None]
    count = int(rng.poisson(0.5 if pose is not None else 1.6))
    if pose is not None and rng.random() < 0.45:
        _hang_wall(rng, image, library, camera, pose, shading)
        conditions.append("wall")
    for _ in range(count):
        _hang_lookalike(rng, image, target, camera, shading)
    if count:
        conditions.append("lookalike")
    if pose is not None:
        _hang_target(rng, image, target, camera, pose, shading, conditions)
    if rng.random() < 0.25:
        image *= light.cast_shadow(rng, camera.height, camera.width)[..., None]
        conditions.append("shadow")
    hidden = _occlude(rng, image, library, target, camera, pose, conditions)
    if rng.random() < 0.08:
        light.flare(rng, image)
        conditions.append("flare")
    rgb = _photograph(rng, image, _disc_px(target, camera, pose), conditions)
    boxes = () if pose is None else label_boxes(target, camera, pose, hidden)
    if boxes and pose is not None:
        _note_view(conditions, boxes, pose)
    quality = int(rng.integers(35, 97))
    return Scene(
        sensor.jpeg(rgb, quality),
        camera.width,
        camera.height,
        tuple(dict.fromkeys(conditions)),
        boxes,
        camera,
        pose if boxes else None,
    )


def label_boxes(
    target: Target, camera: CameraIntrinsics, camera_from_target: Pose, hidden: Mask
) -> tuple[LabelledBox, ...]:
    """Boxes of all levels; none when nothing of the board can be seen.

    Args:
        target: whose levels.
        camera: who looks.
        camera_from_target: where the target is.
        hidden: (H, W), share of each pixel that something in front hides.
    """
    h = image_from_board(camera, camera_from_target)
    boxes = []
    for level, size in target.level_m.items():
        if level is Level.GOOD:
            outline, box = project(h, square_corners(size)), square_box(h, size)
        else:
            outline, box = project(h, circle_points(size / 2)), circle_box(h, size / 2)
        inside = share_inside(outline, camera.width, camera.height)
        boxes.append(LabelledBox(level, box, inside * _share_open(outline, hidden)))
    return tuple(boxes) if any(b.visible > 0 for b in boxes) else ()


def _share_open(outline: Array, hidden: Mask) -> float:
    """Share of the part inside the image that is not hidden."""
    shape = np.zeros(hidden.shape, dtype=np.uint8)
    fixed = np.rint(np.clip(outline, -8000, 8000) * 16).astype(np.int32)
    cv2.fillPoly(shape, [fixed], 255, cv2.LINE_AA, 4)
    weight = shape.astype(np.float64)
    total = weight.sum()
    return float((weight * (1 - hidden)).sum() / total) if total > 0 else 0.0


def _hang_target(
    rng: np.random.Generator,
    image: LinearImage,
    target: Target,
    camera: CameraIntrinsics,
    pose: Pose,
    shading: Mask,
    conditions: list[str],
) -> None:
    h = image_from_board(camera, pose)
    side = target.board_side_m
    texture = draw_target(target, texture_side_px(h, side), random_paint(rng))
    if rng.random() < 0.45:
        wear(rng, texture, rng.uniform(0.1, 1.0))
        conditions.append("worn")
    layer = warp(with_alpha(np.clip(texture, 0, 1)), side, h, camera.width, camera.height)
    if layer is None:
        return
    box = square_box(h, side)
    if rng.random() < 0.4:
        _contact_shadow(rng, image, layer, box)
    lamp = light.light_of_backdrop(rng, image, box)
    lit = lamp * shading[layer.window][..., None]
    paste(image, layer, lit)
    if rng.random() < 0.2:
        rows, columns = layer.window
        spot = light.gloss(rng, layer, box)
        image[rows, columns] += (spot * layer.alpha)[..., None] * lamp
        conditions.append("gloss")


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


def _hang_wall(
    rng: np.random.Generator,
    image: LinearImage,
    library: Library,
    camera: CameraIntrinsics,
    pose: Pose,
    shading: Mask,
) -> None:
    """A wall or a panel in the target's plane, behind it."""
    side = float(np.exp(rng.uniform(np.log(0.5), np.log(4.0))))
    offset = rng.uniform(-0.5, 0.5, 2) * max(0.0, side - 0.45)
    moved = Pose(
        pose.translation + pose.rotation[:, 1] * offset[0] + pose.rotation[:, 2] * offset[1],
        pose.q_wxyz,
    )
    if not is_in_front(moved, side):
        return
    texture = with_alpha(random_wall(rng, library))
    layer = warp(texture, side, image_from_board(camera, moved), camera.width, camera.height)
    if layer is not None:
        lamp = light.light_of_backdrop(rng, image, (0, 0, camera.width, camera.height))
        paste(image, layer, lamp * shading[layer.window][..., None])


def _hang_lookalike(
    rng: np.random.Generator,
    image: LinearImage,
    target: Target,
    camera: CameraIntrinsics,
    shading: Mask,
) -> None:
    side = target.board_side_m
    pose = random_placement(rng, camera, side, side, LOOKALIKE_PX)
    h = image_from_board(camera, pose)
    texture = random_lookalike(rng, texture_side_px(h, side), target)
    if rng.random() < 0.3:
        worn = texture[..., :3].copy()
        wear(rng, worn, rng.uniform(0.1, 0.8))
        texture[..., :3] = np.clip(worn, 0, 1) * texture[..., 3:]
    layer = warp(texture, side, h, camera.width, camera.height)
    if layer is not None:
        lamp = light.light_of_backdrop(rng, image, square_box(h, side))
        paste(image, layer, lamp * shading[layer.window][..., None])


def _occlude(
    rng: np.random.Generator,
    image: LinearImage,
    library: Library,
    target: Target,
    camera: CameraIntrinsics,
    pose: Pose | None,
    conditions: list[str],
) -> Mask:
    """Put things in front, in place; gives how much of each pixel (H, W) they hide."""
    shape = (camera.height, camera.width)
    hidden = np.zeros(shape, dtype=np.float32)
    things = []
    if rng.random() < 0.25:
        if pose is None:
            box = (200.0, 150.0, 400.0, 350.0)
        else:
            box = square_box(image_from_board(camera, pose), target.board_side_m)
        things.append(occluders.random_occluder(rng, library, shape, box))
        conditions.append("occluder")
    if rng.random() < 0.12:
        things.append(occluders.contact_arm(rng, shape))
        conditions.append("arm")
    for thing in things:
        level = np.float32(np.exp(rng.normal(0, 0.5)) * max(float(image[::8, ::8].mean()), 0.02))
        colour = thing.colour * (level / max(float(thing.colour[::8, ::8].mean()), 0.02))
        cover = thing.cover[..., None]
        image += cover * (colour - image)
        hidden += (1 - hidden) * thing.cover
    return hidden


def _disc_px(target: Target, camera: CameraIntrinsics, pose: Pose | None) -> float:
    """Apparent diameter of the outer disc; of one in the middle distance where there is none."""
    if pose is None:
        return 60.0
    return camera.fx * target.discs[0].diameter_m / float(np.linalg.norm(pose.translation))


def _photograph(
    rng: np.random.Generator, image: LinearImage, readable_px: float, conditions: list[str]
) -> NDArray[np.uint8]:
    exposed = sensor.random_exposure(rng, sensor.vignette(rng, image), conditions)
    return sensor.develop(
        rng, sensor.random_optics(rng, exposed, readable_px, conditions), conditions
    )


def _note_view(conditions: list[str], boxes: tuple[LabelledBox, ...], pose: Pose) -> None:
    board = boxes[0]
    size = max(board.xyxy[2] - board.xyxy[0], board.xyxy[3] - board.xyxy[1])
    if size < 40:
        conditions.append("far")
    if size > 320:
        conditions.append("close")
    if board.visible < 0.98:
        conditions.append("partial")
    cosine = -(pose.rotation[:, 0] @ pose.translation) / np.linalg.norm(pose.translation)
    if cosine < np.cos(np.radians(40)):
        conditions.append("tilted")
