"""Where the search for a pose from points starts: closed solutions, refined by OpenCV."""

from __future__ import annotations

import math
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Pose
from target_pose.points import MIN_BREADTH, MIN_POINTS, breadth

Array: TypeAlias = NDArray[np.float64]

SAME_TURN_RAD = math.radians(1.0)
SAME_SHIFT = 0.01
"""Two solutions nearer than this, in turn and in shift over the range, are one."""
MANY_POINTS = 6
"""From here on some may be wrong without all being lost."""
SAMPLES = 24
"""Samples of four points; half of the points may be wrong, and one sample is right with 80 %."""
BOARD_FROM_TARGET = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""OpenCV's planar solver wants the board in x and y: our y and z."""


def planar_poses(yz_m: Array, pixels: Array, focal: Array) -> list[Pose]:
    """The poses, at most three, from which a board's points (N, 2) look as they were seen.

    IPPE (T. Collins, A. Bartoli, "Infinitesimal plane-based pose estimation", 2014) gives both
    folds of a plane, but through a homography, which four points with three of them on a line do
    not fix; SQPnP (G. Terzakis, M. Lourakis, "A consistently fast and globally optimal solution
    to the perspective-n-point problem", 2020) takes any points. Both minimise what is not quite
    the error in the picture, so Levenberg-Marquardt follows.

    Args:
        yz_m: on the board, not on one line.
        pixels: (N, 2), ideal: the principal point at zero.
        focal: (2,) fx and fy [px].

    Returns:
        ``camera_from_target``, best first; those that show the board's front alone.
    """
    flat = np.column_stack([yz_m, np.zeros(len(yz_m))])
    matrix = np.diag([focal[0], focal[1], 1.0])
    found: list[tuple[float, Pose]] = []
    for method in (cv2.SOLVEPNP_IPPE, cv2.SOLVEPNP_SQPNP):
        for pose in _solved(flat, pixels, matrix, method, refined=True):
            if not any(_same(pose, other) for _, other in found):
                found.append((_miss(pose, yz_m, pixels, focal), pose))
    return [pose for _, pose in sorted(found, key=lambda f: f[0])]


def sampled_poses(yz_m: Array, pixels: Array, focal: Array, good_px: float) -> list[Pose]:
    """Likewise where up to half of the points may be wrong, if there are six or more.

    Least median of squares over fixed samples of four (P. J. Rousseeuw, 1984): the same picture
    always gives the same answer. The half of the points that fits best is then solved as a whole.

    Args:
        yz_m: as above.
        pixels: as above.
        focal: as above.
        good_px: where no point is farther off than this, none is wrong and nothing is sampled.
    """
    count = len(yz_m)
    poses = planar_poses(yz_m, pixels, focal)
    if count < MANY_POINTS or (
        poses and _misses(poses[0], yz_m, pixels, focal).max() <= good_px**2
    ):
        return poses
    least, best = math.inf, None
    matrix = np.diag([focal[0], focal[1], 1.0])
    for sample in _samples(count):
        if breadth(yz_m[sample]) < MIN_BREADTH:
            continue
        flat = np.column_stack([yz_m[sample], np.zeros(4)])
        for pose in _solved(flat, pixels[sample], matrix, cv2.SOLVEPNP_IPPE, refined=False):
            misses = _misses(pose, yz_m, pixels, focal)
            middle = float(np.partition(misses, count // 2)[count // 2])
            if middle < least:
                least, best = middle, misses
    if best is None:
        return poses
    near = np.argsort(best, kind="stable")[: max(count // 2 + 1, MIN_POINTS)]
    if breadth(yz_m[near]) < MIN_BREADTH:
        near = np.arange(count)
    return planar_poses(yz_m[near], pixels[near], focal)


def _solved(flat: Array, pixels: Array, matrix: Array, method: int, *, refined: bool) -> list[Pose]:
    """One method's solutions in front of which the camera is."""
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(flat, pixels, matrix, None, flags=method)
        found = list(zip(turns, shifts, strict=True))
        if refined:
            found = [cv2.solvePnPRefineLM(flat, pixels, matrix, None, *one) for one in found]
    except cv2.error:  # how OpenCV says that it has no solution
        return []
    poses = []
    for turn, shift in found:
        if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
            continue
        rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64) @ BOARD_FROM_TARGET
        try:
            pose = Pose.from_rotation(rotation, np.asarray(shift, dtype=np.float64).ravel())
        except GeometryError:
            continue
        if pose.translation[2] > 0 and pose.rotation[:, 0] @ pose.translation < 0:
            poses.append(pose)
    return poses


def _same(one: Pose, other: Pose) -> bool:
    turn = one.rotation.T @ other.rotation
    cosine = (float(np.trace(turn)) - 1) / 2
    apart = float(np.linalg.norm(one.translation - other.translation))
    near = apart < SAME_SHIFT * float(np.linalg.norm(one.translation))
    return near and cosine > math.cos(SAME_TURN_RAD)


def _miss(pose: Pose, yz_m: Array, pixels: Array, focal: Array) -> float:
    return float(_misses(pose, yz_m, pixels, focal).sum())


def _misses(pose: Pose, yz_m: Array, pixels: Array, focal: Array) -> Array:
    """Squared distances (N,) [px^2]; infinite for points that are not ahead."""
    seen = pose @ np.column_stack([np.zeros(len(yz_m)), yz_m])
    with np.errstate(all="ignore"):
        away = seen[:, :2] / seen[:, 2:] * focal - pixels
        squares = np.square(away).sum(axis=1)
    return np.where(seen[:, 2] > 1e-6, squares, np.inf)


def _samples(count: int) -> NDArray[np.intp]:
    """Fixed samples (S, 4) of different points."""
    order = np.random.default_rng(0).random((SAMPLES, count)).argsort(axis=1)
    return np.asarray(order[:, :4])
