"""What is left of a bullseye where its corners are not seen: the sides of the discs' boxes.

A box touches a disc's outline in four points. Which points of the disc they are depends on the
pose, so they are looked for anew under each pose that is tried; that they move does not change the
touched coordinate to first order, since it is an extreme.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from target_pose.box_guess import BORDER_PX
from target_pose.candidate import Box, Candidate
from target_pose.lens import rays_from_pixels
from target_pose.pnp_fit import Measurements, Predict, Predicted, project_points
from target_pose.rings import is_board
from target_pose.target import Target

Array: TypeAlias = NDArray[np.float64]

SIDE_PX, SIDE_SHARE = 1.5, 0.03
"""Standard deviation of a box's side: pixels, and over its size; a detector's regression."""
BOARD_SHARE = 0.15
"""The same for the board's box, which a roll of 45 degrees makes 1.41 times as wide."""
FORESHORTENED = 0.2
"""Standard deviation of a box's shorter extent over its size, by tilt: half of the tilts that a
wall's board is seen under shorten a disc by more. Its middle stays."""
MIN_SIDES = 3
"""Two for the bearing, one for the size."""


def measure_boxes(
    candidate: Candidate, target: Target, intrinsics: CameraIntrinsics
) -> Measurements | None:
    """The sides of a candidate's boxes that the border does not cut; None if they are too few.

    The board's box is taken for that of the disc in it as wide as the board, where no disc's is.
    """
    levels = [level for level in candidate.boxes if not is_board(level, target)]
    sides: list[tuple[float, int, int, float, float]] = []
    for level in levels or list(candidate.boxes):
        box = candidate.boxes[level]
        share = SIDE_SHARE if levels else BOARD_SHARE
        sides += _sides(box, target.level_m[level] / 2, share, intrinsics)
    if len(sides) < MIN_SIDES or len({(axis, end) for _, axis, end, _, _ in sides}) < MIN_SIDES:
        return None
    values, axes, ends, radii, sigmas = (np.array(column) for column in zip(*sides, strict=True))
    focal = np.array([intrinsics.fx, intrinsics.fy])
    predict = _predict_sides(radii, axes.astype(np.intp), ends, focal)
    covariance = np.diag(np.square(sigmas))
    for level in levels or list(candidate.boxes):
        width, height = candidate.boxes[level].size_px
        same = np.isclose(radii, target.level_m[level] / 2) & (axes == int(height < width))
        inward = np.where(same, ends, 0) * FORESHORTENED * min(width, height) / 2
        covariance += np.outer(inward, inward)
    information = np.asarray(np.linalg.inv(covariance))
    return Measurements(values, information, predict, pairs=False)


def _sides(
    box: Box, radius_m: float, share: float, intrinsics: CameraIntrinsics
) -> list[tuple[float, int, int, float, float]]:
    """Value [ideal px], axis, end (-1, 1), radius [m] and deviation [px] of each whole side."""
    (u, v), (width, height) = box.center_px, box.size_px
    sigma = math.hypot(SIDE_PX, share * max(width, height))
    # where the side touches is not known to the box: its middle
    ends = np.array([[box.x0, v], [box.x1, v], [u, box.y0], [u, box.y1]])
    limits = (intrinsics.width, intrinsics.width, intrinsics.height, intrinsics.height)
    ideal = rays_from_pixels(ends, intrinsics) * (intrinsics.fx, intrinsics.fy)
    found = []
    for k, limit in enumerate(limits):
        axis = k // 2
        value, touched = float(ideal[k, axis]), float(ends[k, axis])
        if math.isfinite(value) and BORDER_PX < touched < limit - 1 - BORDER_PX:
            found.append((value, axis, 2 * (k % 2) - 1, radius_m, sigma))
    return found


def _predict_sides(
    radii: Array, axes: NDArray[np.intp], ends: NDArray[np.intp], focal: Array
) -> Predict:
    rows = np.arange(len(radii))

    def predict(translation: Array, rotation: Array, size: float) -> Predicted | None:
        right, up = rotation[:, 1], rotation[:, 2]
        angle = _touching(translation, right, up, radii * (1 + size), axes, ends)
        if angle is None:
            return None
        rim = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up
        whole = project_points(radii[:, None] * rim, translation, focal, size)
        if whole is None:
            return None
        values = whole.values.reshape(-1, 2)[rows, axes]
        return Predicted(values, whole.jacobian.reshape(-1, 2, 7)[rows, axes])

    return predict


def _touching(
    center: Array,
    right: Array,
    up: Array,
    radii: Array,
    axes: NDArray[np.intp],
    ends: NDArray[np.intp],
) -> Array | None:
    """Angles (N,) on the discs at which x/z or y/z is least or greatest.

    Of (A + B cos + C sin) / (D + E cos + F sin) the derivative vanishes where
    P cos + Q sin = R, with P = CD - AF, Q = AE - BD, R = BF - CE.
    """
    a, b, c = center[axes], radii * right[axes], radii * up[axes]
    d, e, f = center[2], radii * right[2], radii * up[2]
    if not d - np.hypot(e, f).max() > 0:
        return None
    p, q, r = c * d - a * f, a * e - b * d, b * f - c * e
    reach = np.hypot(p, q)
    if not (reach > np.abs(r)).all():
        return None  # seen along its plane: a line
    turn = np.arccos(r / reach)
    both = np.arctan2(q, p) + np.stack([turn, -turn])
    cosine, sine = np.cos(both), np.sin(both)
    value = (a + b * cosine + c * sine) / (d + e * cosine + f * sine)
    pick = np.where(ends > 0, value.argmax(axis=0), value.argmin(axis=0))
    return np.asarray(both[pick, np.arange(len(radii))])
