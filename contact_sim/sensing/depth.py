"""Raw depth as a D455's stereo pair gives it: noise and steps of disparity, shadows, and holes.

What a pair can match is decided by what its left eye sees: texture, or the pattern of the projector
where no sun drowns it; nothing where a surface is dark, burnt out, or too near.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contact_sim.errors import RenderError
from contact_sim.scene import Light
from contact_sim.sensing.renderer import View
from rgbd_wire.camera import RgbdCamera

SUBPIXELS = 32
"""Steps of disparity to a pixel."""


@dataclass(frozen=True, slots=True)
class DepthSettings:
    """What the stereo pair is like."""

    sigma_px: float = 0.05
    """Of disparity where there is texture enough; 2.5 mm at 1 m for a D455 at 424x240."""
    correlation_px: float = 1.2
    """Sigma of the smoothing by the matching window."""
    scale_error: float = 0.002
    """Share by which all depths are too long: a worn calibration."""
    nearest_m: float = 0.4
    """What is nearer lies past the search of disparities."""
    patchy: float = 0.05
    """Share that is lost in patches anyhow."""
    least_contrast: float = 0.010
    """Deviation of light, as a share of white, that can just be matched."""


def measured(
    view: View,
    rig: RgbdCamera,
    light: Light,
    rng: np.random.Generator,
    settings: DepthSettings | None = None,
) -> NDArray[np.uint16]:
    """Raw depth (h, w) in the rig's units; 0: none.

    Every value is ``round(A / n / depth_scale_m)`` with a whole ``n`` and A the rig's
    ``depth_lattice_m``.

    Args:
        view: what the left eye sees, and its true depth.
        rig: of the depth camera.
        light: of the world.
        rng: draws noise and holes.
        settings: of the pair.

    Raises:
        RenderError: the rig has no lattice, so its depth comes from no stereo pair.
    """
    s = settings or DepthSettings()
    lattice = rig.depth_lattice_m
    if lattice <= 0:
        raise RenderError("the rig's depth_lattice_m is 0: give fx x baseline x 32 of its pair [m]")
    true_m = view.depth_m
    disparity = np.float32(lattice / SUBPIXELS / (1 + s.scale_error)) / true_m
    contrast, burnt = _contrast(view, light)
    quality = contrast / np.float32(s.least_contrast)
    grain = rng.standard_normal(true_m.shape, dtype=np.float32)
    grain = cv2.GaussianBlur(grain, (0, 0), s.correlation_px)
    # the less there is to match, the worse it is matched
    sigma = np.float32(s.sigma_px / grain.std()) * (1 + 1.5 / np.maximum(quality, 0.3) ** 2)
    n = np.maximum(np.rint(SUBPIXELS * (disparity + sigma * grain)), 1)
    units = np.rint(np.float64(lattice / rig.depth_scale_m) / n)
    patches = _smooth(rng, true_m.shape, cells=14)
    blind = quality < 1 + 0.5 * patches
    blind |= burnt | (true_m < s.nearest_m) | ~np.isfinite(true_m) | (units > 65_535)
    blind |= patches > np.quantile(patches[::4, ::4], 1 - s.patchy)
    blind |= unseen_by_right_eye(disparity)
    units[blind] = 0
    return np.asarray(units.astype(np.uint16))


def unseen_by_right_eye(disparity_px: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Where the left eye sees what the right one does not (h, w): left of near edges.

    Column u of the left picture lies at u - d in the right one; a column to its right that lands at
    or left of there stands before it. What lands off the picture has no match either.
    """
    landing = np.arange(disparity_px.shape[1], dtype=np.float32) - disparity_px
    first = np.minimum.accumulate(landing[:, ::-1], axis=1)[:, ::-1]
    hidden = landing < 0
    hidden[:, :-1] |= first[:, 1:] <= landing[:, :-1]
    return np.asarray(hidden)


def _contrast(view: View, light: Light) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Deviation of light (h, w) within a matching window, and where the eye is burnt out."""
    seen = np.square(view.color[..., 1].astype(np.float32) / 255)
    # the eyes have an exposure of their own, which is longer, and infrared to help
    lift = np.float32(np.clip(0.2 / max(float(seen[::4, ::4].mean()), 1e-6), 0.02, 40.0))
    bright = np.minimum(seen * lift, 1.0)
    mean = cv2.blur(bright, (7, 7))
    variance = np.maximum(cv2.blur(bright * bright, (7, 7)) - mean * mean, 0)
    pattern = np.float32(0.12 * light.projector) * np.sqrt(mean) / np.square(view.depth_m)
    burnt = cv2.blur((bright >= 0.98).astype(np.float32), (7, 7)) > 0.9
    return np.sqrt(variance + np.square(np.minimum(pattern, 0.2))), np.asarray(burnt)


def _smooth(rng: np.random.Generator, shape: tuple[int, ...], cells: int) -> NDArray[np.float32]:
    """Smooth noise (h, w), about normal."""
    coarse = rng.standard_normal((cells, cells)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC))
