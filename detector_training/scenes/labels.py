"""Where each level of the target truly is in a picture, and how much of it can be seen."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detector_training.scenes.image import Mask
from detector_training.scenes.projection import (
    circle_box,
    circle_points,
    image_from_board,
    project,
    share_inside,
    square_box,
    square_corners,
    square_points,
)
from detector_training.scenes.relief import Relief
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Array, Pose
from target_pose.target import Level, Target


@dataclass(frozen=True, slots=True)
class LabelledBox:
    """Where one level of the target truly is."""

    level: Level
    xyxy: tuple[float, float, float, float]
    """Around the projected shape, not clipped by the image [px]."""
    visible: float
    """Share of the shape's area that lies in the image and is not hidden, [0, 1]."""


def label_boxes(
    target: Target,
    camera: CameraIntrinsics,
    camera_from_target: Pose,
    hidden: Mask,
    relief: Relief | None = None,
) -> tuple[LabelledBox, ...]:
    """Boxes of all levels; none when nothing of the board can be seen.

    Args:
        target: whose levels.
        camera: who looks.
        camera_from_target: where the target is.
        hidden: (H, W), share of each pixel that something in front hides.
        relief: the shape of a print that is not flat.
    """
    h = image_from_board(camera, camera_from_target)
    boxes = []
    for level, size in target.level_m.items():
        square = level is Level.GOOD
        if relief is not None:
            flat = square_points(size) if square else circle_points(size / 2)
            outline = relief.outline(flat, camera, camera_from_target)
            (x0, y0), (x1, y1) = outline.min(0).tolist(), outline.max(0).tolist()
            box = (x0, y0, x1, y1)
        elif square:
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
