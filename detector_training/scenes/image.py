"""Pictures in linear light, and the ways in and out of it."""

from __future__ import annotations

from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

LinearImage: TypeAlias = NDArray[np.float32]
"""(H, W, 3) RGB in linear light, 0 to 1 for what a sensor can hold; over 1 is over-exposed."""
Mask: TypeAlias = NDArray[np.float32]
"""(H, W) in [0, 1]."""

_STEPS = np.arange(256, dtype=np.float64) / 255
_LINEAR_OF_BYTE = np.where(
    _STEPS <= 0.04045, _STEPS / 12.92, ((_STEPS + 0.055) / 1.055) ** 2.4
).astype(np.float32)


def linear_from_srgb(rgb: NDArray[np.uint8]) -> LinearImage:
    """Linear light of 8-bit sRGB (IEC 61966-2-1)."""
    return np.asarray(cv2.LUT(rgb, _LINEAR_OF_BYTE))


def srgb_from_linear(image: LinearImage) -> NDArray[np.uint8]:
    """8-bit sRGB of linear light; what is over 1 or under 0 is clipped."""
    x = np.clip(image, 0.0, 1.0)
    curved = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, np.float32(1 / 2.4)) - 0.055)
    return np.asarray(np.rint(curved * 255).astype(np.uint8))


def luminance(image: LinearImage) -> Mask:
    """Luminance (H, W) by the weights of Rec. 709."""
    return np.asarray(image @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32))


def over(top_premultiplied: LinearImage, alpha: Mask, below: LinearImage) -> LinearImage:
    """``top`` (already times its alpha) laid over ``below``."""
    return np.asarray(top_premultiplied + (1.0 - alpha[..., None]) * below)


def smooth_noise(
    rng: np.random.Generator, height: int, width: int, cells: int, channels: int = 1
) -> NDArray[np.float32]:
    """Smooth noise (H, W) or (H, W, channels), about normal, of ``cells`` waves a side."""
    shape = (max(2, cells), max(2, cells), channels)
    coarse = rng.standard_normal(shape).astype(np.float32)
    fine = np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))
    return fine.reshape(height, width) if channels == 1 else fine


def cloud_noise(
    rng: np.random.Generator, height: int, width: int, cells: int, octaves: int = 4
) -> NDArray[np.float32]:
    """Sum of smooth noises, each twice as fine and half as strong: stains, plaster, rock."""
    total = np.zeros((height, width), dtype=np.float32)
    for octave in range(octaves):
        total += smooth_noise(rng, height, width, cells * 2**octave) / 2**octave
    return total
