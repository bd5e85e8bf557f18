"""The printed target as a flat texture: albedo of paper and ink, its wear and its stains."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import cloud_noise
from target_pose.target import Shade, Target


@dataclass(frozen=True, slots=True)
class Paint:
    """Albedo (linear) of the two shades."""

    white: NDArray[np.float32]  # (3,)
    black: NDArray[np.float32]  # (3,)

    def of(self, shade: Shade) -> NDArray[np.float32]:
        """Albedo (3,) of a shade."""
        return self.white if shade is Shade.WHITE else self.black


def random_paint(rng: np.random.Generator) -> Paint:
    """Paper and ink as printers and years leave them: seldom white, seldom black, a bit tinted."""
    tint = 1 + 0.06 * rng.standard_normal(3)
    white = np.clip(rng.uniform(0.5, 0.95) * tint, 0.3, 1.0)
    black = np.clip(rng.uniform(0.015, 0.12) * (1 + 0.15 * rng.standard_normal(3)), 0.005, 0.2)
    return Paint(white.astype(np.float32), black.astype(np.float32))


def radius_grid(side_px: int, side_m: float) -> NDArray[np.float32]:
    """Distance [m] of each texel of a square texture (N, N) from the centre."""
    c = ((np.arange(side_px, dtype=np.float32) + 0.5) / side_px - 0.5) * np.float32(side_m)
    return np.asarray(np.hypot(c[:, None], c[None, :]))


def disc_coverage(
    radius_of_texel_m: NDArray[np.float32], radius_m: float, texel_m: float
) -> NDArray[np.float32]:
    """Share of each texel that a centred disc covers, to first order across its edge."""
    return np.asarray(np.clip((radius_m - radius_of_texel_m) / texel_m + 0.5, 0.0, 1.0))


def draw_target(target: Target, side_px: int, paint: Paint) -> NDArray[np.float32]:
    """The clean target as albedo (N, N, 3)."""
    grid = radius_grid(side_px, target.board_side_m)
    texel = target.board_side_m / side_px
    image = np.broadcast_to(paint.of(target.board_shade), (side_px, side_px, 3)).copy()
    for disc in target.discs:
        c = disc_coverage(grid, disc.diameter_m / 2, texel)[..., None]
        image += c * (paint.of(disc.shade) - image)
    return image


def wear(rng: np.random.Generator, albedo: NDArray[np.float32], strength: float) -> None:
    """Dirt, scratches and drips on a print, in place; ``strength`` in [0, 1]."""
    n = albedo.shape[0]
    if strength <= 0 or n < 8:
        return
    dirt = np.clip(cloud_noise(rng, n, n, int(rng.integers(2, 7))) - 0.3, 0, 1.5) * strength
    colour = rng.uniform(0.02, 0.25, 3).astype(np.float32)
    albedo += np.clip(dirt * 0.6, 0, 0.55)[..., None] * (colour - albedo)
    lines = np.zeros((n, n), dtype=np.uint8)
    for _ in range(int(rng.poisson(8 * strength))):
        a = rng.uniform(0, n, 2)
        b = a + rng.normal(0, 0.25 * n, 2)
        thick = max(1, round(n * rng.uniform(0.001, 0.008)))
        cv2.line(lines, _point(a), _point(b), 255, thick, cv2.LINE_AA)
    scratch = lines.astype(np.float32) / 255 * rng.uniform(0.3, 0.9)
    bare = np.float32(rng.uniform(0.05, 0.8))
    albedo += scratch[..., None] * (bare - albedo)


def with_alpha(albedo: NDArray[np.float32]) -> NDArray[np.float32]:
    """An opaque texture (N, N, 4)."""
    return np.dstack([albedo, np.ones(albedo.shape[:2], dtype=np.float32)])


def _point(p: NDArray[np.float64]) -> tuple[int, int]:
    return int(p[0]), int(p[1])
