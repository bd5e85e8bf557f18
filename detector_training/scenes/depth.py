"""Depth as a D455 gives it, aligned to the colour picture: noise, a scale error, holes, shadows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.errors import SceneError
from detector_training.scenes.geometry import Geometry, true_depth
from detector_training.scenes.image import cloud_noise
from detector_training.scenes.stereo import unseen_by_other_eye

SCALE_M = 0.001
"""One unit of a depth picture."""
NO_DEPTH_SHARE = 0.1
"""Pictures whose depth is nothing but holes: fog, glare, a covered imager."""
BASELINE_M = 0.095
"""Between a D455's imagers."""
MAX_DISPARITY_PX = 126
"""Of a RealSense's search; what is nearer has no match."""
_STREAM = 5
"""Keeps the chance of depth apart from that of pictures, which it must not change."""


class DepthSensor(StrEnum):
    """What measures the depth of a scene."""

    NONE = "none"
    D455 = "d455"


@dataclass(frozen=True, slots=True)
class DepthNoise:
    """How good a depth picture is."""

    sigma_per_m: float = 2.5e-3
    """Sigma of depth z is this times z^2; constant in inverse depth, as a stereo pair's is."""
    blur_px: float = 1.2
    """Sigma of the matching window's blur: noise falls to 1/e of its covariance at twice this."""
    scale_error: float = 0.0
    """Share by which all depths are too long."""
    hole_share: float = 0.1
    """Share of the picture without depth, shadows included; shadows alone may be more."""


def random_noise(rng: np.random.Generator) -> DepthNoise:
    """10 to 45 % holes and a calibration that is 0.2 to 0.5 % off, either way."""
    sign = 1.0 if rng.random() < 0.5 else -1.0
    return DepthNoise(
        scale_error=sign * float(rng.uniform(0.002, 0.005)),
        hole_share=float(rng.uniform(0.10, 0.45)),
    )


def depth_of(seed: tuple[int, ...], scene: Geometry) -> NDArray[np.uint16]:
    """The depth picture (H, W) of the scene of a seed in units of ``SCALE_M``; 0 is none."""
    rng = np.random.default_rng((*seed, _STREAM))
    if rng.random() < NO_DEPTH_SHARE:
        return np.zeros((scene.camera.height, scene.camera.width), dtype=np.uint16)
    depth_m = true_depth(rng, scene)
    return measured(rng, depth_m, scene.camera.fx, random_noise(rng))


def measured(
    rng: np.random.Generator, depth_m: NDArray[np.float32], fx_px: float, noise: DepthNoise
) -> NDArray[np.uint16]:
    """What the sensor reports (H, W) for true depth (H, W) [m], in units of ``SCALE_M``."""
    grain = rng.standard_normal(depth_m.shape)
    grain = np.asarray(cv2.GaussianBlur(grain, (0, 0), noise.blur_px))
    inverse = 1 / (depth_m.astype(np.float64) * (1 + noise.scale_error))
    inverse += noise.sigma_per_m * grain / grain.std()
    # behind infinity the pair sees nothing
    units = np.rint(1 / np.maximum(inverse, 1e-6) / SCALE_M)
    disparity = fx_px * BASELINE_M / depth_m.astype(np.float64)
    blind = unseen_by_other_eye(disparity) | (disparity > MAX_DISPARITY_PX) | (units > 65_535)
    return np.asarray(np.where(_holes(rng, blind, noise.hole_share), 0, units).astype(np.uint16))


def _holes(rng: np.random.Generator, blind: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Patches without a match beside what is blind anyway, until their share is reached."""
    height, width = blind.shape
    patches = cloud_noise(rng, height, width, int(rng.integers(5, 20)))
    lacking = share - float(blind.mean())
    if lacking <= 0:
        return blind
    limit = np.quantile(patches[~blind], 1 - lacking / (1 - float(blind.mean())))
    return np.asarray(blind | (patches > limit))


def png_of(depth: NDArray[np.uint16]) -> bytes:
    """A depth picture (H, W) as 16-bit PNG.

    Raises:
        SceneError: it cannot be encoded.
    """
    done, data = cv2.imencode(".png", depth, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not done:
        raise SceneError(f"a depth picture of {depth.shape} cannot be written as PNG")
    return data.tobytes()


def description() -> dict[str, Any]:
    """What a reader of the depth pictures must know, for ``dataset.json``."""
    return {
        "sensor": str(DepthSensor.D455),
        "files": "depth/NNNNNN.png, 16 bit, 0 = none, aligned to the colour picture",
        "scale_m": SCALE_M,
        "sigma_m": f"{DepthNoise().sigma_per_m:g} z^2",
        "share_without_any": NO_DEPTH_SHARE,
        "truth": "exact on the target and its wall, plausible elsewhere",
    }
