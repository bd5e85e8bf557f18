"""How a picture of any size goes into the net, and how boxes come back."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from edge_service.detector.grid import padded_side
from edge_service.errors import ImageError

MIN_SIDE_PX, MAX_SIDE_PX = 16, 4096
WORKING_SIDE_PX = 640
"""A longer picture is shrunk to this: it bounds the time that a frame takes."""
PADDING_GRAY = 114


@dataclass(frozen=True, slots=True)
class Letterbox:
    """The scaling of one picture into the net's input."""

    scale_u: float
    scale_v: float
    """Pixels of the input per pixel of the picture."""
    left_px: float = 0.0
    top_px: float = 0.0
    """Padding before the picture in the input."""

    def to_picture(self, boxes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Boxes (..., 4) of the input in the picture's pixels (both count from pixel centres)."""
        corners = boxes.reshape(*boxes.shape[:-1], 2, 2)
        return self.points_to_picture(corners).reshape(boxes.shape)

    def points_to_picture(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Points (..., 2) of the input in the picture's pixels."""
        scale = np.array([self.scale_u, self.scale_v], np.float32)
        shift = np.array([self.left_px, self.top_px], np.float32)
        return np.asarray((points - shift + 0.5) / scale - 0.5, np.float32)


def check_image(color_rgb: NDArray[np.uint8]) -> None:
    """Refuse what is no colour picture of a bearable size.

    Raises:
        ImageError: says what it is and what it may be.
    """
    if not isinstance(color_rgb, np.ndarray) or color_rgb.dtype != np.uint8:
        kind = getattr(color_rgb, "dtype", type(color_rgb).__name__)
        raise ImageError(f"a picture is an array of uint8, not {kind}")
    if color_rgb.ndim != 3 or color_rgb.shape[2] != 3:
        raise ImageError(f"a picture has the shape (H, W, 3), not {color_rgb.shape}")
    height, width = color_rgb.shape[:2]
    if min(height, width) < MIN_SIDE_PX or max(height, width) > MAX_SIDE_PX:
        raise ImageError(
            f"a picture's side is {MIN_SIDE_PX} to {MAX_SIDE_PX} px, not {width}x{height}"
        )


def letterbox(color_rgb: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Letterbox]:
    """The net's input: shrunk to the working size, padded right and below with gray.

    Args:
        color_rgb: (H, W, 3).

    Returns:
        (H', W', 3) with sides that are multiples of the coarsest stride, and its scaling.
    """
    height, width = color_rgb.shape[:2]
    shrink = min(WORKING_SIDE_PX / max(height, width), 1.0)
    w, h = max(round(width * shrink), 1), max(round(height * shrink), 1)
    resized = color_rgb
    if (w, h) != (width, height):
        resized = np.asarray(cv2.resize(color_rgb, (w, h), interpolation=cv2.INTER_AREA), np.uint8)
    box = Letterbox(w / width, h / height)
    if (padded_side(w), padded_side(h)) == (w, h):
        return resized, box
    padded = np.full((padded_side(h), padded_side(w), 3), PADDING_GRAY, np.uint8)
    padded[:h, :w] = resized
    return padded, box


def letterbox_into(
    color_rgb: NDArray[np.uint8], size: tuple[int, int]
) -> tuple[NDArray[np.uint8], Letterbox]:
    """The input of a net of one size: the picture as large as fits, gray on both sides of it.

    As the YOLO family is trained, a small picture is enlarged. What is shrunk is averaged by area:
    a thin ring does not alias.

    Args:
        color_rgb: (H, W, 3).
        size: (H', W') of the input [px].
    """
    height, width = color_rgb.shape[:2]
    scale = min(size[0] / height, size[1] / width)
    h, w = max(round(height * scale), 1), max(round(width * scale), 1)
    top, left = (size[0] - h) // 2, (size[1] - w) // 2
    padded = np.full((*size, 3), PADDING_GRAY, np.uint8)
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    padded[top : top + h, left : left + w] = (
        color_rgb if (h, w) == (height, width) else cv2.resize(color_rgb, (w, h), interpolation=way)
    )
    return padded, Letterbox(w / width, h / height, left, top)
