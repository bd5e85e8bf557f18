"""Things in front of the target: the drone's own arm, cables, pipes, sheets, pieces of photos."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.backdrop import Library, random_patch
from detector_training.scenes.image import LinearImage, Mask, cloud_noise
from detector_training.scenes.surfaces import random_colour


@dataclass(frozen=True, slots=True)
class Occluder:
    """What hides a part of the picture."""

    colour: LinearImage  # (H, W, 3)
    cover: Mask  # (H, W)


def random_occluder(
    rng: np.random.Generator,
    library: Library,
    shape: tuple[int, int],
    box: tuple[float, float, float, float],
) -> Occluder:
    """One thing that hides up to about half of ``box`` in a picture of ``shape`` (H, W)."""
    kind = rng.choice(["blob", "bar", "patch", "leaves", "cable"], p=[0.25, 0.25, 0.25, 0.1, 0.15])
    height, width = shape
    x0, y0, x1, y1 = box
    size = max(x1 - x0, y1 - y0)
    edge = rng.uniform(0, 2 * np.pi)
    reach = rng.uniform(0.25, 0.7) * size
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2]) + reach * np.array(
        [np.cos(edge), np.sin(edge)]
    )
    mask = np.zeros(shape, dtype=np.uint8)
    if kind == "bar":
        _bar(rng, mask, centre, rng.uniform(0.05, 0.3) * size)
    elif kind == "cable":
        _cable(rng, mask, centre, size)
    else:
        count = int(rng.integers(3, 10))
        angle = np.sort(rng.uniform(0, 2 * np.pi, count))
        radius = rng.uniform(0.15, 0.55) * size * rng.uniform(0.5, 1.0, count)
        points = centre + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        cv2.fillPoly(mask, [np.rint(points * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
    cover = np.float32(1 / 255) * mask
    if kind == "leaves":
        noise = cloud_noise(rng, height, width, int(np.clip(4 * width / max(size, 8), 4, 60)), 2)
        cover *= np.clip(noise * 4, 0, 1)
    if kind == "patch" and library.photos:
        colour = random_patch(rng, library.photos, width, height)
    else:
        colour = _painted(rng, shape)
    return Occluder(colour, cover)


def contact_arm(rng: np.random.Generator, shape: tuple[int, int]) -> Occluder:
    """The drone's own arm: a rod from the lower border towards the middle, with a tip."""
    height, width = shape
    mask = np.zeros(shape, dtype=np.uint8)
    start = np.array([rng.uniform(0.2, 0.8) * width, height * rng.uniform(1.0, 1.2)])
    if rng.random() < 0.2:
        start = np.array([rng.uniform(0.2, 0.8) * width, -height * rng.uniform(0.0, 0.2)])
    tip = rng.uniform((0.35, 0.4), (0.65, 0.8)) * (width, height)
    thick0, thick1 = rng.uniform(10, 70), rng.uniform(5, 25)
    along = (tip - start) / np.linalg.norm(tip - start)
    across = np.array([-along[1], along[0]])
    quad = [start + across * thick0, tip + across * thick1, tip - across * thick1]
    quad.append(start - across * thick0)
    cv2.fillPoly(mask, [np.rint(np.array(quad) * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
    cv2.circle(mask, _point(tip), int(thick1 * rng.uniform(1.0, 2.2)), 255, -1, cv2.LINE_AA)
    colour = _painted(rng, shape)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    side = ((x - start[0]) * across[0] + (y - start[1]) * across[1]) / max(thick0, 1)
    colour *= np.clip(1 + 0.5 * side, 0.3, 1.7)[..., None]
    return Occluder(colour.astype(np.float32), np.float32(1 / 255) * mask)


def _painted(rng: np.random.Generator, shape: tuple[int, int]) -> LinearImage:
    height, width = shape
    shade = 1 + 0.2 * cloud_noise(rng, height, width, int(rng.integers(2, 8)), 2)
    return np.asarray(np.clip(shade, 0.2, 2)[..., None] * random_colour(rng))


def _bar(
    rng: np.random.Generator, mask: NDArray[np.uint8], centre: NDArray[np.float64], thick: float
) -> None:
    angle = rng.uniform(0, np.pi)
    far = 2 * max(mask.shape) * np.array([np.cos(angle), np.sin(angle)])
    a, b = centre - far, centre + far
    if rng.random() < 0.4:
        b = centre
    cv2.line(mask, _point(a), _point(b), 255, max(1, round(thick)), cv2.LINE_AA)


def _cable(
    rng: np.random.Generator, mask: NDArray[np.uint8], centre: NDArray[np.float64], size: float
) -> None:
    steps = rng.normal(0, 0.5 * size + 20, (5, 2))
    knots = centre + np.cumsum(steps, axis=0) - steps[:2].sum(0)
    t = np.linspace(0, 1, 40)[:, None]
    curve = np.zeros((40, 2))
    for i, c in enumerate((1, 4, 6, 4, 1)):  # a Bezier curve of degree 4
        curve += c * t**i * (1 - t) ** (4 - i) * knots[i]
    thick = max(1, round(rng.uniform(0.01, 0.06) * size))
    cv2.polylines(mask, [np.rint(curve).astype(np.int32)], False, 255, thick, cv2.LINE_AA)


def _point(p: NDArray[np.float64]) -> tuple[int, int]:
    limit = 30_000  # OpenCV's line drawing overflows far beyond
    x, y = np.clip(np.rint(p), -limit, limit)
    return int(x), int(y)
