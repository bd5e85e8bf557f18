"""Where the chase camera flies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.recording.chase import NEAREST_M, chase, looking, smoothed

RATE_HZ = 25.0
BOARD = np.array([3.0, 0.0, 1.5])
NORMAL = np.array([-1.0, 0.0, 0.0])
HALF_FOV_RAD = 0.5
"""What both must lie in, a little less than half of what the film's camera sees."""


def open_air(origin: np.ndarray, direction: np.ndarray) -> float:
    return float("inf")


def approach(n: int = 100, side_m: float = 0.0) -> np.ndarray:
    """From 3 m before the board to contact, as the body flies."""
    return np.column_stack((np.linspace(0.0, 2.4, n), np.full(n, side_m), np.full(n, 1.5)))


@given(st.floats(-1.0, 1.0))
def test_drone_and_board_are_in_view_all_along(side_m: float):
    """From far away until the arm touches, wherever the drone comes from."""
    drone = approach(side_m=side_m)
    for pose, here in zip(chase(drone, BOARD, NORMAL, RATE_HZ, open_air), drone, strict=True):
        for thing in (here, BOARD):
            in_camera = pose.inverse() @ thing
            assert in_camera[2] > 0.5
            assert abs(np.arctan2(in_camera[0], in_camera[2])) < HALF_FOV_RAD


def test_the_horizon_is_level():
    """The camera's right is horizontal, and its down is down."""
    for pose in chase(approach(), BOARD, NORMAL, RATE_HZ, open_air):
        right, down = pose.rotation[:, 0], pose.rotation[:, 1]
        assert abs(right[2]) < 1e-9
        assert down[2] < -0.5


def test_it_moves_smoothly_behind_a_drone_that_does_not():
    """A jump of half a metre in one picture is no jump of the camera."""
    drone = approach()
    drone[50:, 1] += 0.5
    eyes = np.array([p.translation for p in chase(drone, BOARD, NORMAL, RATE_HZ, open_air)])
    assert np.linalg.norm(np.diff(eyes, axis=0), axis=1).max() < 0.1


@pytest.mark.parametrize("wall_m", [1.0, 1.4])
def test_it_stays_out_of_a_wall(wall_m: float):
    """A wall behind the drone holds it back, smoothly; but it never sits in the drone."""
    drone = np.tile([0.0, 0.0, 1.5], (100, 1))

    def walled(origin: np.ndarray, direction: np.ndarray) -> float:
        return float((-wall_m - origin[0]) / direction[0]) if direction[0] < 0 else np.inf

    for pose in chase(drone, BOARD, NORMAL, RATE_HZ, walled):
        assert pose.translation[0] >= -wall_m - 1e-6
        assert np.linalg.norm(pose.translation - drone[0]) >= NEAREST_M - 1e-6


def test_it_takes_the_side_with_more_room():
    """To the left of a drone with a wall on its right."""

    def right_wall(origin: np.ndarray, direction: np.ndarray) -> float:
        return float((-0.5 - origin[1]) / direction[1]) if direction[1] < 0 else np.inf

    eyes = [p.translation for p in chase(approach(), BOARD, NORMAL, RATE_HZ, right_wall)]
    assert all(eye[1] > 0.5 for eye in eyes)


def test_looking_looks():
    """The point lies on the axis."""
    at = np.array([3.0, 1.0, 0.5])
    np.testing.assert_allclose(
        (looking(np.array([0.0, 0.0, 1.0]), at).inverse() @ at)[:2], 0.0, atol=1e-12
    )


@given(st.floats(0.5, 8.0), st.floats(-3.0, 3.0))
def test_smoothing_keeps_what_is_straight(sigma: float, value: float):
    """What stands still does so, at the ends too."""
    rows = np.full((20, 2), value)
    np.testing.assert_allclose(smoothed(rows, sigma), rows, atol=1e-9)
