"""A drawn target on a drawn wall: the picture by which an engine shows that it works."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from target_pose.candidate import Box
from target_pose.target import Level, Shade, Target

SIZE = (480, 640)
"""(H, W) of the picture [px], that of most cameras' streams."""
SIDES_PX = (220.0, 120.0, 60.0)
"""Sides of the board in the pictures: near, middle, far."""

_CENTERS_PX = ((250.0, 260.0), (400.0, 220.0), (180.0, 150.0))
_SQUEEZE = 0.92  # seen a little from the side
_GRAY = {Shade.BLACK: 28.0, Shade.WHITE: 205.0}
_BLUR_PX = 0.7
_NOISE = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A picture and where the target is in it."""

    color_rgb: NDArray[np.uint8]  # (H, W, 3)
    boxes: dict[Level, Box]


def draw(target: Target) -> tuple[Drawn, ...]:
    """One picture for each of ``SIDES_PX``, by the target's geometry; always the same."""
    rng = np.random.default_rng(2024)
    return tuple(_draw(target, *scene, rng) for scene in zip(SIDES_PX, _CENTERS_PX, strict=True))


def _draw(
    target: Target, side_px: float, center: tuple[float, float], rng: np.random.Generator
) -> Drawn:
    height, width = SIZE
    coarse = rng.uniform(60, 150, (height // 40 + 1, width // 40 + 1, 3))
    picture = np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))
    v, u = np.mgrid[:height, :width]
    x, y = (u - center[0]) / _SQUEEZE, v - center[1]
    px_per_m = side_px / target.board_side_m
    # each edge is a ramp of one pixel: what a lens and a pixel's area make of it
    inside = np.clip(side_px / 2 - np.maximum(abs(x), abs(y)) + 0.5, 0, 1)
    _paint(picture, inside, target.board_shade)
    radius = np.hypot(x, y)
    for disc in target.discs:
        inside = np.clip(disc.diameter_m * px_per_m / 2 - radius + 0.5, 0, 1)
        _paint(picture, inside, disc.shade)
    picture = cv2.GaussianBlur(picture, (0, 0), _BLUR_PX) + rng.normal(0, _NOISE, picture.shape)
    boxes = {}
    for level, side_m in target.level_m.items():
        h = side_m * px_per_m / 2
        w = h * _SQUEEZE
        boxes[level] = Box(center[0] - w, center[1] - h, center[0] + w, center[1] + h, 1.0)
    return Drawn(np.clip(np.round(picture), 0, 255).astype(np.uint8), boxes)


def _paint(picture: NDArray[np.float64], inside: NDArray[np.float64], shade: Shade) -> None:
    """Cover ``picture`` (H, W, 3) with a shade where ``inside`` (H, W) says so; in place."""
    picture += inside[..., None] * (_GRAY.get(shade, 120.0) - picture)
