"""Procedural surfaces, seen head-on: plaster, tiles, bricks, cabinets, boards, pipes, carpet."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import LinearImage, cloud_noise

Surface: TypeAlias = LinearImage
Drawer: TypeAlias = Callable[[np.random.Generator, int], Surface]


def random_surface(rng: np.random.Generator, side_px: int = 384) -> Surface:
    """Any of them, (N, N, 3) albedo."""
    return _DRAWERS[int(rng.integers(len(_DRAWERS)))](rng, side_px)


def random_colour(rng: np.random.Generator) -> NDArray[np.float32]:
    """A paint (3,): mostly greys and dull tones, at times a strong one."""
    level = rng.beta(1.6, 2.0)
    spread = 0.6 if rng.random() < 0.3 else 0.12
    colour = level * np.exp(rng.normal(0, spread, 3))
    return np.clip(colour, 0.01, 0.95).astype(np.float32)


def plaster(rng: np.random.Generator, n: int) -> Surface:
    """Painted wall with faint stains."""
    stain = cloud_noise(rng, n, n, int(rng.integers(2, 10))) * rng.uniform(0.01, 0.2)
    return _shaded(random_colour(rng), 1 + stain)


def rock(rng: np.random.Generator, n: int) -> Surface:
    """Rough rock or sprayed concrete, as in a tunnel."""
    relief = cloud_noise(rng, n, n, int(rng.integers(4, 24)), octaves=5)
    slope = np.gradient(relief, axis=0) * n / 40
    return _shaded(random_colour(rng), 1 + 0.25 * relief + rng.uniform(0.1, 0.5) * slope)


def tiles(rng: np.random.Generator, n: int) -> Surface:
    """Tiles or bricks with joints, each of a slightly other shade."""
    rows, columns = int(rng.integers(3, 24)), int(rng.integers(2, 20))
    bond = rng.random() < 0.5
    v = np.arange(n) / n * rows
    row = v.astype(int)
    u = np.arange(n)[None, :] / n * columns + (0.5 * (row % 2) if bond else 0 * row)[:, None]
    shades = 1 + rng.uniform(0, 0.35) * rng.standard_normal((rows, columns + 1))
    shade = shades[row[:, None], u.astype(int) % (columns + 1)]
    joint = rng.uniform(0.02, 0.1)
    line = ((u % 1) < joint * columns / rows) | ((v % 1) < joint)[:, None]
    shade *= 1 + 0.1 * cloud_noise(rng, n, n, 8)
    image = _shaded(random_colour(rng), shade.astype(np.float32))
    image[line] = random_colour(rng)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7))


def cabinets(rng: np.random.Generator, n: int) -> Surface:
    """Doors and drawers with gaps, handles and a sheen, each of one colour."""
    colour = random_colour(rng)
    gradient = np.linspace(rng.uniform(0.6, 1.4), rng.uniform(0.6, 1.4), n, dtype=np.float32)
    image = _shaded(colour, np.broadcast_to(gradient[:, None], (n, n)))
    columns = int(rng.integers(2, 6))
    dark, metal = colour * 0.25, np.full(3, rng.uniform(0.2, 0.9), dtype=np.float32)
    for c in range(columns):
        x0, x1 = c * n // columns, (c + 1) * n // columns
        cuts = np.sort(rng.uniform(0, 1, int(rng.integers(0, 4))))
        edges = [0, *(cuts * n).astype(int).tolist(), n]
        for y0, y1 in zip(edges[:-1], edges[1:], strict=True):
            _rectangle(image, x0, y0, x1, y1, dark, max(1, n // 150))
            if rng.random() < 0.3:  # a panel
                m = (x1 - x0) // 8
                _rectangle(image, x0 + m, y0 + m, x1 - m, y1 - m, colour * 0.6, max(1, n // 200))
            if rng.random() < 0.8:
                y = y0 + max(3, (y1 - y0) // 8)
                a = x0 + (x1 - x0) // 4
                _rectangle(image, a, y, x1 - (x1 - x0) // 4, y + max(1, n // 120), metal, -1)
    return image


def wood(rng: np.random.Generator, n: int) -> Surface:
    """Planks with a grain."""
    colour = np.array([0.35, 0.18, 0.08], dtype=np.float32) * np.float32(rng.uniform(0.3, 2.0))
    grain = cloud_noise(rng, n, max(8, n // 24), 6)
    grain = np.asarray(cv2.resize(grain, (n, n), interpolation=cv2.INTER_CUBIC))
    image = _shaded(colour, 1 + rng.uniform(0.05, 0.3) * grain)
    for x in np.linspace(0, n, int(rng.integers(2, 9)))[1:-1].astype(int):
        image[:, x : x + max(1, n // 200)] *= 0.35
    return image if rng.random() < 0.5 else np.ascontiguousarray(image.transpose(1, 0, 2))


def stripes(rng: np.random.Generator, n: int) -> Surface:
    """Carpet, corrugated sheet, blinds or a grating."""
    waves = rng.uniform(4, 60)
    x = np.arange(n) / n
    profile = np.sin(2 * np.pi * waves * x + rng.uniform(0, 6))
    if rng.random() < 0.5:
        profile = np.sign(profile)
    shade = 1 + rng.uniform(0.05, 0.6) * profile[None, :] + 0.1 * cloud_noise(rng, n, n, 16)
    image = _shaded(random_colour(rng), shade.astype(np.float32))
    return image if rng.random() < 0.5 else np.ascontiguousarray(image.transpose(1, 0, 2))


def clutter(rng: np.random.Generator, n: int) -> Surface:
    """A wall with sheets, books, switches and round things on it."""
    image = plaster(rng, n)
    for _ in range(int(rng.integers(3, 25))):
        x, y = rng.integers(0, n, 2)
        w, h = (rng.uniform(0.02, 0.25, 2) * n).astype(int) + 2
        colour = random_colour(rng)
        if rng.random() < 0.8:
            _rectangle(image, int(x), int(y), int(x + w), int(y + h), colour, -1)
            if rng.random() < 0.5:
                inner = random_colour(rng)
                _rectangle(
                    image,
                    int(x + w // 5),
                    int(y + h // 5),
                    int(x + w // 2),
                    int(y + h // 2),
                    inner,
                    -1,
                )
        else:
            cv2.circle(image, (int(x), int(y)), int(w // 2), colour.tolist(), -1, cv2.LINE_AA)
    return image


def pipes(rng: np.random.Generator, n: int) -> Surface:
    """Shaded pipes in front of a wall, with flanges."""
    image = rock(rng, n) if rng.random() < 0.5 else plaster(rng, n)
    for _ in range(int(rng.integers(1, 6))):
        x0, w = int(rng.integers(0, n)), int(rng.uniform(0.02, 0.15) * n) + 3
        x1 = min(n, x0 + w)
        across = np.linspace(-1, 1, w)[: x1 - x0]
        shade = np.sqrt(1 - 0.9 * across**2) * (1 + 0.3 * across)
        image[:, x0:x1] = shade[None, :, None] * random_colour(rng)
        for y in rng.integers(0, n, int(rng.integers(0, 4))):
            image[y : y + n // 40, max(0, x0 - w // 4) : x1 + w // 4] *= 0.6
    return image if rng.random() < 0.5 else np.ascontiguousarray(image.transpose(1, 0, 2))


def _shaded(colour: NDArray[np.float32], shade: NDArray[np.float32]) -> Surface:
    return np.asarray(np.clip(shade, 0.05, 4)[..., None] * colour, dtype=np.float32)


def _rectangle(
    image: Surface, x0: int, y0: int, x1: int, y1: int, colour: NDArray[np.float32], thick: int
) -> None:
    cv2.rectangle(image, (x0, y0), (x1, y1), colour.tolist(), thick)


_DRAWERS: tuple[Drawer, ...] = (
    plaster, rock, tiles, tiles, cabinets, cabinets, wood, stripes, clutter, clutter, pipes,
)  # fmt: skip
