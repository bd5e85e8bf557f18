"""Where the camera flies that follows the drone: behind it, to one side, with the board in view.

Pure, but for the question how far one may go in a direction. The whole flight is known, so the
way is smoothed from both sides and lags behind nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.geometry import Array, Pose

Free: TypeAlias = Callable[[Array, Array], float]
"""Free metres from a place (3,) along a unit vector (3,)."""

BEHIND_M: Final = 1.5
BESIDE_M: Final = 1.1
ABOVE_M: Final = 0.7
NEAREST_M: Final = 0.6
"""Of the camera to the drone: in it there is nothing to see."""
AHEAD: Final = 0.45
"""The camera looks at a point this share of the way from the drone to the board."""
SMOOTH_S: Final = 0.6
UP: Final = np.array([0.0, 0.0, 1.0])


def chase(
    drone_world: NDArray[np.float64],
    board_world: Array,
    normal_world: Array,
    rate_hz: float,
    free: Free,
) -> list[Pose]:
    """``world_from_camera`` (RDF) for each picture of a film.

    Args:
        drone_world: (n, 3) where the drone is.
        board_world: (3,) centre of the board.
        normal_world: (3,) out of the board.
        rate_hz: pictures a second.
        free: how far the world lets one go.
    """
    sigma = SMOOTH_S * rate_hz
    drone = smoothed(drone_world, sigma)
    back = drone - board_world
    back[:, 2] = 0.0
    flat = np.array([normal_world[0], normal_world[1], 0.0])
    # near the board the normal tells better than the few centimetres of the way to it
    near = np.exp(-np.linalg.norm(back, axis=1, keepdims=True))
    back = _unit((1.0 - near) * _unit(back) + near * flat)
    ways = [_offsets(back, side) for side in (1.0, -1.0)]
    shares = [_free_shares(drone, way, free) for way in ways]
    best = max(range(2), key=lambda i: float(np.mean(shares[i])))
    share = _held_back(shares[best], sigma)
    eye = drone + share[:, None] * ways[best]
    look = drone + AHEAD * (board_world - drone)
    return [looking(e, at) for e, at in zip(eye, smoothed(look, sigma), strict=True)]


def looking(eye: Array, at: Array) -> Pose:
    """``world_from_camera`` (RDF) of a level camera at a place that looks at another one."""
    forward = at - eye
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, UP)
    right = right / np.linalg.norm(right)
    down = np.cross(forward, right)
    return Pose.from_rotation(np.column_stack((right, down, forward)), eye)


def smoothed(rows: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Each column (n, k) through a Gaussian of ``sigma`` rows; the ends go on as they end."""
    half = max(1, int(np.ceil(3 * sigma)))
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / max(sigma, 1e-6)) ** 2)
    weights /= weights.sum()
    padded = np.pad(rows, ((half, half), (0, 0)), mode="edge")
    columns = [np.convolve(padded[:, i], weights, mode="valid") for i in range(rows.shape[1])]
    return np.column_stack(columns)


def _offsets(back: NDArray[np.float64], side: float) -> NDArray[np.float64]:
    beside = side * np.cross(UP, back)
    return BEHIND_M * back + BESIDE_M * beside + ABOVE_M * UP


def _free_shares(
    drone: NDArray[np.float64], way: NDArray[np.float64], free: Free
) -> NDArray[np.float64]:
    """What share of the way from the drone to the camera is free, (n,)."""
    shares = np.empty(len(drone))
    for i, (here, offset) in enumerate(zip(drone, way, strict=True)):
        length = float(np.linalg.norm(offset))
        shares[i] = min(1.0, max(NEAREST_M, free(here, offset / length)) / length)
    return shares


def _held_back(shares: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Smooth, and never more than is free: the least of a window, then the mean of a smaller."""
    half = int(np.ceil(3 * sigma))
    padded = np.pad(shares, half, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    return smoothed(windows.min(axis=1)[:, None], sigma)[:, 0]


def _unit(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9))
