"""What a caller hands to a localiser: does it fit the camera, and can it be used?"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from target_pose.box_guess import BoxGuess, box_guesses
from target_pose.candidate import Candidate
from target_pose.lens import rays_from_pixels
from target_pose.localisation import Refusal
from target_pose.target import Target
from target_pose.vectors import length

Array: TypeAlias = NDArray[np.float64]

MIN_DISC_PX = 8.0
"""Least width of the outer disc."""


def fits_camera(
    color_rgb: NDArray[np.uint8],
    depth_units: NDArray[np.uint16] | None,
    camera: RgbdCamera,
    up_camera: Array | None,
) -> bool:
    """Whether pictures and up vector have the shapes and types that the camera says."""
    color, raw = camera.color, camera.depth
    if color_rgb.shape != (color.height, color.width, 3) or color_rgb.dtype != np.uint8:
        return False
    if depth_units is not None and (
        depth_units.shape != (raw.height, raw.width) or depth_units.dtype != np.uint16
    ):
        return False
    return up_camera is None or np.asarray(up_camera, dtype=np.float64).shape == (3,)


def usable_up(up_camera: Array | None) -> Array | None:
    """The up vector (3,), or None where it has no direction."""
    if up_camera is None:
        return None
    up = np.asarray(up_camera, dtype=np.float64)
    with np.errstate(over="ignore"):
        usable = 1e-6 < length(up) < 1e6  # false for NaN, too
    return up if usable else None


def usable_guesses(
    candidate: Candidate, target: Target, intrinsics: CameraIntrinsics
) -> list[BoxGuess] | Refusal:
    """Where the outer disc may be, the best first; or why its boxes say nothing."""
    guesses = box_guesses(candidate, target, intrinsics)
    if not guesses:
        return Refusal.BAD_BOX
    if max(guess.width_px for guess in guesses) < MIN_DISC_PX:
        return Refusal.TOO_SMALL
    centers = np.array([guess.disc.center_px for guess in guesses])
    if not np.isfinite(rays_from_pixels(centers, intrinsics)).all():
        return Refusal.BAD_INTRINSICS
    return guesses
