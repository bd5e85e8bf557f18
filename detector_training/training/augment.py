"""Light augmentation: random crops at random scales, mirrors, light, blur and noise.

Never an inversion: dark on light is what tells the target from its look-alikes.

And no mosaic of four pictures in one. The levels of a target are nested and concentric, and what
tells it from a ring is that they are all there: a seam through a board leaves half-boards in the
middle of a picture, which no camera sees, and their boxes would reach over the seam as those of a
target cut by the picture's own border do, so the net would learn to guess past any straight edge.
What a mosaic is used for, small objects in many surroundings, the scales and backgrounds do here.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from target_pose.target import Level

PADDING_GRAY = 114
"""What lies outside of the picture, in training as in the engine."""

MIN_SCALE, MAX_SCALE = 0.4, 1.6
"""Pixels of the crop per pixel of the picture."""

MIN_VISIBLE = 0.35
"""A box of which less is to be seen is neither taught nor punished."""
MIN_SIDE_PX = 7.0
"""Likewise a box with a smaller shorter side."""

_OUTERMOST = list(Level).index(Level.GOOD)


class Crop(NamedTuple):
    """A training picture; M boxes."""

    image: NDArray[np.uint8]  # (H, W, 3) RGB
    boxes: NDArray[np.float32]  # (M, 4) [px]
    classes: NDArray[np.int64]  # (M,)
    ignore: NDArray[np.bool_]  # (M,)


def inside_share(boxes: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    """Share (M,) of each box's area that lies in the picture."""
    low = np.maximum(boxes[:, :2], -0.5)
    high = np.minimum(boxes[:, 2:], np.array([width - 0.5, height - 0.5], np.float32))
    inside = np.prod(np.clip(high - low, 0, None), axis=1)
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    return np.asarray(inside / np.maximum(area, 1e-6), np.float32)


def choose_window(
    boxes: NDArray[np.float32],
    size: tuple[int, int],
    out_size: tuple[int, int],
    rng: np.random.Generator,
) -> tuple[float, float, float]:
    """Left and top edge [px] and scale of a random window; three of four show a target.

    Args:
        boxes: Outermost box of each target (M, 4) in the picture.
        size: Width and height of the picture.
        out_size: Width and height of the crop.
        rng: Source of chance.
    """
    low, high = np.log(MIN_SCALE), np.log(MAX_SCALE)
    if len(boxes) and rng.random() < 0.75:
        box = boxes[rng.integers(len(boxes))]
        side = float((box[2:] - box[:2]).max())
        # Neither larger than the crop nor, for a far one, shrunk to nothing
        high = min(high, float(np.log(1.1 * min(out_size) / side)))
        low = max(low, min(float(np.log(24.0 / side)), 0.0))
        scale = float(np.exp(rng.uniform(low, max(low, high))))
        at = rng.uniform(0.05, 0.95, 2) * out_size / scale
        left, top = (box[:2] + box[2:]) / 2 - at
        return float(left), float(top), scale
    scale = float(np.exp(rng.uniform(low, high)))
    room = np.array(size) - np.array(out_size) / scale
    left, top = np.where(room > 0, rng.uniform(0, np.maximum(room, 1e-9)), room / 2)
    return float(left), float(top), scale


def crop(
    image: NDArray[np.uint8],
    window: tuple[float, float, float],
    out_size: tuple[int, int],
    mirror: bool,
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """A window of a picture and its map: crop = picture * (sx, sy) + (tx, ty).

    Returns:
        The crop (H, W, 3), padded with gray where the window leaves the picture, and
        (sx, sy, tx, ty) [px]; sx is negative in a mirrored crop.
    """
    left, top, scale = window
    height, width = image.shape[:2]
    x0, y0 = max(round(left), 0), max(round(top), 0)
    x1 = min(round(left + out_size[0] / scale), width)
    y1 = min(round(top + out_size[1] / scale), height)
    out = np.full((out_size[1], out_size[0], 3), PADDING_GRAY, np.uint8)
    ox, oy = max(round((x0 - left) * scale), 0), max(round((y0 - top) * scale), 0)
    w = min(max(round((x1 - x0) * scale), 0), out_size[0] - ox)
    h = min(max(round((y1 - y0) * scale), 0), out_size[1] - oy)
    sx = sy = scale
    tx = ty = 0.0
    if x1 > x0 and y1 > y0 and w > 0 and h > 0:
        how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        out[oy : oy + h, ox : ox + w] = cv2.resize(image[y0:y1, x0:x1], (w, h), interpolation=how)
        sx, sy = w / (x1 - x0), h / (y1 - y0)
        # resize keeps the outer edges of the pixels, half a pixel from their centres
        tx = ox + (0.5 - x0) * sx - 0.5
        ty = oy + (0.5 - y0) * sy - 0.5
    if mirror:
        out = np.ascontiguousarray(out[:, ::-1])
        sx, tx = -sx, out_size[0] - 1 - tx
    return out, np.array([sx, sy, tx, ty])


def map_boxes(
    boxes: NDArray[np.float32], picture_to_crop: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Boxes (M, 4) of the picture in the crop, edges in order even when mirrored."""
    sx, sy, tx, ty = picture_to_crop
    x = np.sort(boxes[:, 0::2] * sx + tx, axis=1)
    y = boxes[:, 1::2] * sy + ty
    return np.stack((x[:, 0], y[:, 0], x[:, 1], y[:, 1]), 1).astype(np.float32)


def random_light(image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Random white balance, exposure, contrast and gamma by one monotonic table per channel."""
    level = np.linspace(0, 1, 256)[:, None]
    gain = np.exp(rng.normal(0, 0.22)) * np.exp(rng.normal(0, 0.05, 3))
    curve = np.clip(level ** np.exp(rng.normal(0, 0.22)) * gain, 0, 1)
    lift = rng.uniform(0, 0.08)
    table = (255 * (lift + (1 - lift) * curve)).astype(np.uint8)
    lit = cv2.LUT(image, table.reshape(256, 1, 3))
    if rng.random() < 0.1:
        lit = cv2.cvtColor(cv2.cvtColor(lit, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    return np.asarray(lit, np.uint8)


def random_blur(image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Blur by defocus or by a short straight motion."""
    if rng.random() < 0.5:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 1.6)), np.uint8)
    length = int(rng.integers(3, 9))
    kernel = np.zeros((length, length), np.float32)
    angle = rng.uniform(0, np.pi)
    reach = (length - 1) / 2 * np.array([np.cos(angle), np.sin(angle)])
    middle = (length - 1) / 2
    start, end = np.round(middle - reach).astype(int), np.round(middle + reach).astype(int)
    cv2.line(kernel, start.tolist(), end.tolist(), 1.0)
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.uint8)


def random_noise(image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Additive noise of a random strength."""
    noise = np.empty(image.shape, np.int16)
    # OpenCV's generator is ten times as fast as numpy's; the seed keeps it reproducible
    cv2.setRNGSeed(int(rng.integers(1 << 31)))
    cv2.randn(noise, 0, float(rng.uniform(1, 12)))
    return np.asarray(np.clip(image + noise, 0, 255), np.uint8)


def augment(
    image: NDArray[np.uint8],
    boxes: NDArray[np.float32],
    classes: NDArray[np.int64],
    visible: NDArray[np.float32],
    out_size: tuple[int, int],
    rng: np.random.Generator,
) -> Crop:
    """One random training crop of a labelled picture.

    Args:
        image: (H, W, 3) RGB.
        boxes: (M, 4) [px].
        classes: (M,).
        visible: (M,), visible share in the picture.
        out_size: Width and height of the crop [px].
        rng: Source of chance.
    """
    height, width = image.shape[:2]
    anchors = boxes[(classes == _OUTERMOST) & (visible > 0.3)]
    window = choose_window(anchors, (width, height), out_size, rng)
    out, picture_to_crop = crop(image, window, out_size, mirror=bool(rng.random() < 0.5))
    if rng.random() < 0.6:
        out = random_light(out, rng)
    if rng.random() < 0.08:
        out = random_blur(out, rng)
    if rng.random() < 0.1:
        out = random_noise(out, rng)
    moved = map_boxes(boxes, picture_to_crop)
    share = inside_share(moved, *out_size)
    before = np.maximum(inside_share(boxes, width, height), 1e-3)
    seen = visible * share / before
    side = (moved[:, 2:] - moved[:, :2]).min(axis=1) if len(moved) else np.zeros(0, np.float32)
    present = share > 0.01
    ignore = (seen < MIN_VISIBLE) | (side < MIN_SIDE_PX)
    return Crop(out, moved[present], classes[present], ignore[present])
