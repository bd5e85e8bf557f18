"""Flat textures seen in perspective, with every edge filtered over the pixel's area."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import LinearImage, Mask
from detector_training.scenes.projection import project, square_corners
from rgbd_wire.geometry import Array

SUPERSAMPLING = 3
MAX_TEXTURE_PX = 1024
MIN_TEXTURE_PX = 24


@dataclass(frozen=True, slots=True)
class Layer:
    """A warped texture where it falls in the image."""

    x0: int
    """Left column in the image."""
    y0: int
    """Top row in the image."""
    premultiplied: LinearImage  # (h, w, 3)
    alpha: Mask  # (h, w)

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the image that the layer covers."""
        h, w = self.alpha.shape
        return slice(self.y0, self.y0 + h), slice(self.x0, self.x0 + w)


def texture_side_px(image_from_plane: Array, side_m: float) -> int:
    """Texture side that gives about one texel to each of the finer samples of a pixel."""
    corners = project(image_from_plane, square_corners(side_m))
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1).max()
    return int(np.clip(longest * SUPERSAMPLING, MIN_TEXTURE_PX, MAX_TEXTURE_PX))


def plane_from_texture(side_px: int, side_m: float) -> Array:
    """Affine map (3, 3) from texel (column, row, 1) to (y, z, 1) [m]; texel centres are whole."""
    s = side_m / side_px
    return np.array(
        [[s, 0.0, (0.5 - side_px / 2) * s], [0.0, -s, (side_px / 2 - 0.5) * s], [0.0, 0.0, 1.0]]
    )


def warp(
    texture: NDArray[np.float32],
    side_m: float,
    image_from_plane: Array,
    width: int,
    height: int,
) -> Layer | None:
    """A square texture (N, N, 4), premultiplied RGBA, of ``side_m`` as the camera sees it.

    Returns:
        None when nothing of it falls in the image.
    """
    corners = project(image_from_plane, square_corners(side_m))
    x0, y0 = np.maximum(np.floor(corners.min(0) - 1), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(corners.max(0) + 2), (width, height)).astype(int)
    if x1 <= x0 or y1 <= y0:
        return None
    w, h, s = int(x1 - x0), int(y1 - y0), SUPERSAMPLING
    # a fine sample (i, j) sits at pixel x0 - 0.5 + (i + 0.5) / s
    fine_from_image = np.array(
        [
            [s, 0.0, (0.5 - x0) * s - 0.5],
            [0.0, s, (0.5 - y0) * s - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    matrix = fine_from_image @ image_from_plane @ plane_from_texture(texture.shape[0], side_m)
    fine = cv2.warpPerspective(
        texture, matrix, (w * s, h * s), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
    )
    coarse = np.asarray(cv2.resize(fine, (w, h), interpolation=cv2.INTER_AREA))
    return Layer(int(x0), int(y0), coarse[..., :3], coarse[..., 3])


def paste(image: LinearImage, layer: Layer, light: LinearImage | None = None) -> None:
    """Lay ``layer`` over ``image`` in place, lit by ``light`` (h, w, 3) when given."""
    rows, columns = layer.window
    top = layer.premultiplied if light is None else layer.premultiplied * light
    image[rows, columns] = top + (1 - layer.alpha[..., None]) * image[rows, columns]
