"""Depth as a D455 gives it: noise in disparity, steps of 1/32 px, shadows beside edges, holes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import cloud_noise
from rgbd_wire.camera import RgbdCamera

SUBPIXELS = 32
"""Steps of disparity to a pixel."""


@dataclass(frozen=True, slots=True)
class StereoNoise:
    """How good the depth is."""

    sigma_px: float = 0.05
    """Of disparity, after filtering; 2.5 mm at 1 m for a D455 at 424x240."""
    correlation_px: float = 1.2
    """Width of the matching window's smoothing."""
    scale_error: float = 0.002
    """Share by which all depths are too long: a worn calibration."""
    hole_share: float = 0.08
    """Share of the picture without a match, in patches; shadows come on top."""


def raw_depth(
    rng: np.random.Generator,
    depth_m: NDArray[np.float32],
    camera: RgbdCamera,
    noise: StereoNoise,
) -> NDArray[np.uint16]:
    """What the sensor reports (H, W) for true depth (H, W) [m]; 0 where there is none.

    Every value is ``round(A / n / depth_scale_m)`` with a whole ``n`` and A the camera's
    ``depth_lattice_m``.
    """
    lattice = camera.depth_lattice_m
    disparity = lattice / SUBPIXELS / (depth_m.astype(np.float64) * (1 + noise.scale_error))
    grain = rng.standard_normal(depth_m.shape)
    grain = np.asarray(cv2.GaussianBlur(grain, (0, 0), noise.correlation_px))
    n = np.rint(SUBPIXELS * (disparity + noise.sigma_px * grain / grain.std()))
    n = np.maximum(n, 1)
    units = np.rint(lattice / n / camera.depth_scale_m)
    patches = cloud_noise(rng, depth_m.shape[0], depth_m.shape[1], cells=10)
    holes = patches > np.quantile(patches, 1 - noise.hole_share)
    units[holes | unseen_by_other_eye(disparity) | (units > 65_535)] = 0
    return np.asarray(units.astype(np.uint16))


def unseen_by_other_eye(disparity_px: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where the left imager sees what the right one does not (H, W): to the left of near edges.

    Column u of the left picture is seen at u - d on the right; a point to its right that lands at
    or left of that place hides it. Columns that fall off the right picture have no match either.
    """
    landing = np.arange(disparity_px.shape[1]) - disparity_px
    nearest = np.minimum.accumulate(landing[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(landing.shape, dtype=bool)
    hidden[:, :-1] = nearest[:, 1:] <= landing[:, :-1]
    return np.asarray(hidden | (landing < 0))
