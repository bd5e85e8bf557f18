"""Pixels to rays and back through the lens, both of RealSense's distortion models, vectorised."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics

Array: TypeAlias = NDArray[np.float64]

NEWTON_STEPS = 12
"""Real lenses take three; the rest is for strong ones near their border."""
LAST_STEP = 1e-6
"""Step [focal lengths] after which Newton's next one would be no more than rounding."""
INVERSE_TOLERANCE = 1e-8
"""Residual [focal lengths] past which a point has no inverse: 1e-5 px."""


def rays_from_pixels(uv_px: Array, intrinsics: CameraIntrinsics) -> Array:
    """Where the rays of pixels (N, 2) cross the plane z = 1 in front of the camera.

    Returns:
        (N, 2) x/z and y/z; NaN where the lens model has no inverse.
    """
    i = intrinsics
    seen = (uv_px - (i.cx, i.cy)) / (i.fx, i.fy)
    if i.model == "none" or not any(i.coefficients):
        return np.asarray(seen)
    if i.model == "inverse_brown_conrady":
        return _distorted(seen, i.coefficients)
    return _undistorted(seen, i.coefficients)


def pixels_from_rays(xy: Array, intrinsics: CameraIntrinsics) -> Array:
    """Pixels (N, 2) of points (N, 2) on the plane z = 1.

    Returns:
        (N, 2) px; NaN where the lens model has no inverse.
    """
    i = intrinsics
    if i.model == "none" or not any(i.coefficients):
        seen = xy
    elif i.model == "inverse_brown_conrady":
        seen = _undistorted(xy, i.coefficients)
    else:
        seen = _distorted(xy, i.coefficients)
    return np.asarray(seen * (i.fx, i.fy) + (i.cx, i.cy))


def project(points: Array, intrinsics: CameraIntrinsics) -> Array:
    """Pixels (N, 2) of points (N, 3) in the camera frame; NaN for those not in front of it."""
    depth = points[:, 2:]
    ahead = np.where(depth > 1e-6, depth, np.nan)
    return pixels_from_rays(points[:, :2] / ahead, intrinsics)


def _distorted(xy: Array, coefficients: tuple[float, ...]) -> Array:
    """The Brown-Conrady polynomial (D. C. Brown, "Decentering distortion of lenses", 1966)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
        ],
        axis=-1,
    )


def _undistorted(seen: Array, coefficients: tuple[float, ...]) -> Array:
    """The polynomial's inverse by Newton's method, from the seen point itself.

    NaN where it does not converge, or only onto the far side of the polynomial's turning point
    (Jacobian not positive), where no real lens maps.
    """
    k1, k2, p1, p2, k3 = coefficients
    xy = np.array(seen, dtype=np.float64)
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            x, y = xy[..., 0], xy[..., 1]
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
            j_xx = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
            j_xy = x * y * slope + 2 * p1 * x + 2 * p2 * y
            j_yy = radial + y * y * slope + 2 * p2 * x + 6 * p1 * y
            det = j_xx * j_yy - j_xy * j_xy
            off = _distorted(xy, coefficients) - seen
            step_x = (j_yy * off[..., 0] - j_xy * off[..., 1]) / det
            step_y = (j_xx * off[..., 1] - j_xy * off[..., 0]) / det
            xy[..., 0] -= step_x
            xy[..., 1] -= step_y
            if max(np.abs(step_x).max(initial=0), np.abs(step_y).max(initial=0)) < LAST_STEP:
                break
        miss = np.abs(_distorted(xy, coefficients) - seen).max(axis=-1, initial=0)
        bad = ~(miss <= INVERSE_TOLERANCE) | ~(det > 0) | ~(j_xx > 0)
    xy[bad] = np.nan
    return xy
