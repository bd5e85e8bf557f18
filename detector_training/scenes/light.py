"""Light on the target: the room's own, gradients, cast shadows, gloss and flare."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import LinearImage, Mask, luminance, smooth_noise
from detector_training.scenes.warp import Layer


def light_of_backdrop(
    rng: np.random.Generator, backdrop: LinearImage, box: tuple[float, float, float, float]
) -> NDArray[np.float32]:
    """Light (3,) that makes a board look as if it hung there.

    White paper seldom is darker than what surrounds it, so the light is taken from the brighter
    part of the surroundings, with half of its colour (the rest is the paint's own).
    """
    h, w = backdrop.shape[:2]
    x0, y0, x1, y1 = box
    mx, my = 0.6 * (x1 - x0) + 20, 0.6 * (y1 - y0) + 20
    rows = slice(int(np.clip(y0 - my, 0, h - 2)), int(np.clip(y1 + my, 2, h)))
    columns = slice(int(np.clip(x0 - mx, 0, w - 2)), int(np.clip(x1 + mx, 2, w)))
    around = backdrop[rows, columns].reshape(-1, 3)
    if not len(around):
        around = backdrop.reshape(-1, 3)
    around = around[:: max(1, len(around) // 4000)]
    bright = luminance(around)
    level = float(np.quantile(bright, rng.uniform(0.5, 0.95)))
    level = max(level, 0.15 * float(luminance(backdrop[::16, ::16]).max()), 0.01)
    level *= np.exp(rng.normal(0.25, 0.45))
    mean = around.mean(0) + 1e-3
    tint = (mean / mean.mean()) ** rng.uniform(0.0, 0.6)
    return np.asarray(level * tint / 0.75, dtype=np.float32)


def shading(rng: np.random.Generator, height: int, width: int) -> Mask:
    """A field (H, W) about 1: a gradient across, and soft spots of a lamp or of the sun."""
    y, x = np.mgrid[0 : 1 : complex(height), 0 : 1 : complex(width)].astype(np.float32)
    angle, strength = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.6)
    ramp = (x - 0.5) * np.cos(angle) + (y - 0.5) * np.sin(angle)
    field = np.exp(strength * 1.6 * ramp)
    if rng.random() < 0.4:
        field *= np.exp(0.3 * smooth_noise(rng, height, width, int(rng.integers(2, 5))))
    if rng.random() < 0.25:  # a torch
        cx, cy, r = rng.uniform(0, 1), rng.uniform(0, 1), rng.uniform(0.15, 0.7)
        spot = np.exp(-(((x - cx) ** 2 + (y - cy) ** 2) / r**2))
        field *= rng.uniform(0.1, 0.6) + spot * rng.uniform(0.5, 1.5)
    return np.asarray(field, dtype=np.float32)


def cast_shadow(rng: np.random.Generator, height: int, width: int) -> Mask:
    """A factor (H, W): polygons, bars or leaves between the lamp and the wall."""
    mask = np.zeros((height, width), dtype=np.uint8)
    size = max(height, width)
    for _ in range(int(rng.integers(1, 4))):
        centre = rng.uniform((-0.1, -0.1), (1.1, 1.1)) * (width, height)
        count = int(rng.integers(3, 9))
        angle = np.sort(rng.uniform(0, 2 * np.pi, count))
        radius = rng.uniform(0.1, 0.6) * size * rng.uniform(0.4, 1.0, count)
        points = centre + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        cv2.fillPoly(mask, [points.astype(np.int32)], 255)
    blur = rng.uniform(0.5, 20)
    soft = np.asarray(cv2.GaussianBlur(mask, (0, 0), blur)).astype(np.float32) / 255
    return np.asarray(1 - rng.uniform(0.25, 0.85) * soft, dtype=np.float32)


def gloss(rng: np.random.Generator, layer: Layer, box: tuple[float, ...]) -> Mask:
    """Light mirrored by the board, of the layer's size, added to what the print reflects.

    ``box`` is around the board in the image.
    """
    height, width = layer.alpha.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    w, h = box[2] - box[0], box[3] - box[1]
    cx = box[0] + rng.uniform(0, 1) * w - layer.x0
    cy = box[1] + rng.uniform(0, 1) * h - layer.y0
    a = rng.uniform(0, np.pi)
    u = (x - cx) * np.cos(a) + (y - cy) * np.sin(a)
    v = (y - cy) * np.cos(a) - (x - cx) * np.sin(a)
    su, sv = rng.uniform(0.08, 0.6) * w + 1, rng.uniform(0.05, 0.3) * h + 1
    spot = np.exp(-0.5 * ((u / su) ** 2 + (v / sv) ** 2))
    return np.asarray(rng.uniform(0.05, 1.2) * spot, dtype=np.float32)


def flare(rng: np.random.Generator, image: LinearImage) -> None:
    """A lamp in or near the picture: a glow, a veil and ghosts, added in place."""
    h, w = image.shape[:2]
    q = 4
    y, x = np.mgrid[0 : h // q, 0 : w // q].astype(np.float32) * q
    cx, cy = rng.uniform(-0.1, 1.1) * w, rng.uniform(-0.1, 1.1) * h
    r2 = (x - cx) ** 2 + (y - cy) ** 2
    glow = np.exp(-r2 / (2 * (rng.uniform(0.02, 0.15) * w) ** 2)) * rng.uniform(0.5, 3)
    glow += rng.uniform(0.02, 0.25) / (1 + r2 / (0.3 * w) ** 2)
    for _ in range(int(rng.integers(0, 4))):  # ghosts lie on the line through the centre
        t = rng.uniform(-1.5, 1.5)
        gx, gy = w / 2 + t * (cx - w / 2), h / 2 + t * (cy - h / 2)
        radius = rng.uniform(0.01, 0.08) * w
        ghost = np.clip(1.5 - np.hypot(x - gx, y - gy) / radius, 0, 1)
        glow += rng.uniform(0.02, 0.1) * ghost
    tint = np.exp(rng.normal(0, 0.15, 3)).astype(np.float32)
    up = np.asarray(cv2.resize(glow, (w, h), interpolation=cv2.INTER_LINEAR))
    image += up[..., None] * tint
