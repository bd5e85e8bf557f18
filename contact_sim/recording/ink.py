"""Words and lines on pictures (H, W, 3) RGB."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Picture: TypeAlias = NDArray[np.uint8]  # (H, W, 3)
Color: TypeAlias = tuple[int, int, int]

WHITE: Final[Color] = (240, 240, 240)
GREY: Final[Color] = (165, 170, 178)
GREEN: Final[Color] = (90, 220, 110)
RED: Final[Color] = (255, 105, 85)
AMBER: Final[Color] = (255, 190, 60)
PAPER: Final[Color] = (22, 25, 30)
"""What everything is drawn on."""
SOFT_PX: Final = 0.8
_SHIFT: Final = 4
"""Bits of a pixel's fractions in OpenCV's lines."""


@cache
def _face(weight: int) -> tuple[Any, int]:
    return cv2.FontFace("sans"), weight


def write(
    picture: Picture,
    text: str,
    at: tuple[int, int],
    size_px: int = 15,
    color: Color = WHITE,
    *,
    bold: bool = False,
    right: bool = False,
) -> None:
    """Write on a picture; ``at`` is where the base line begins, or with ``right`` ends."""
    face, weight = _face(700 if bold else 400)
    x, y = at
    if right:
        height, width = picture.shape[:2]
        box = cv2.getTextSize((width, height), text, (0, 0), face, size_px, weight=weight)
        x -= int(box[2])
    cv2.putText(picture, text, (x, y), color, face, size_px, weight=weight)


def shade(picture: Picture, x0: int, y0: int, x1: int, y1: int, share: float = 0.35) -> None:
    """Darken a rectangle to a share of its light, for words on top of it."""
    part = picture[max(0, y0) : y1, max(0, x0) : x1]
    part[:] = (part * np.float32(share)).astype(np.uint8)


def softened(picture: Picture) -> Picture:
    """Without the finest grain, which nobody looks at and which costs most of an encoder's time."""
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), SOFT_PX))


def line(
    picture: Picture, points_px: NDArray[np.float64], color: Color, thickness: int = 1
) -> None:
    """A line strip (n, 2), smooth and to a fraction of a pixel."""
    points = np.round(np.clip(points_px, -1e4, 1e4) * (1 << _SHIFT)).astype(np.int32)
    cv2.polylines(picture, [points.reshape(-1, 1, 2)], False, color, thickness, cv2.LINE_AA, _SHIFT)


def rgb(color: Sequence[float]) -> Color:
    """Of shares in [0, 1]."""
    r, g, b = (round(255 * c) for c in color)
    return r, g, b
