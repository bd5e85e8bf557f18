"""NED/FRD and ENU/FLU, against scipy's rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from drone_client.autopilot.ned import (
    covariance_from_triangle,
    swap_attitude,
    swap_body,
    swap_pose,
    swap_world,
    swap_yaw_rate,
    triangle_from_covariance,
)
from rgbd_wire.geometry import Pose

vectors = arrays(np.float64, 3, elements=st.floats(-100.0, 100.0))
angles = arrays(np.float64, 3, elements=st.floats(-math.pi, math.pi))
ENU_TO_NED = Rotation.from_rotvec(math.pi * np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0))
FLU_TO_FRD = Rotation.from_rotvec(math.pi * np.array([1.0, 0.0, 0.0]))


def wxyz(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(), 1)


def same_rotation(a: np.ndarray, b: np.ndarray) -> bool:
    return abs(abs(float(a @ b)) - 1.0) < 1e-12


def test_the_words_say_it() -> None:
    """East is NED's y, up is minus its z; FLU's left is minus FRD's right."""
    assert swap_world(np.array([1.0, 2.0, 3.0])).tolist() == [2.0, 1.0, -3.0]
    assert swap_body(np.array([1.0, 2.0, 3.0])).tolist() == [1.0, -2.0, -3.0]


@given(vectors)
def test_vectors_agree_with_half_turns_and_come_back(v: np.ndarray) -> None:
    """Both changes are half turns, by scipy, and their own inverse."""
    assert np.allclose(swap_world(v), ENU_TO_NED.apply(v), atol=1e-9)
    assert np.allclose(swap_body(v), FLU_TO_FRD.apply(v), atol=1e-9)
    assert (swap_world(swap_world(v)) == v).all()
    assert (swap_body(swap_body(v)) == v).all()


@given(angles)
def test_attitudes_agree_with_scipy_and_come_back(rotvec: np.ndarray) -> None:
    """NED-from-FRD is NED-from-ENU, ENU-from-FLU and FLU-from-FRD, one after the other."""
    enu_from_flu = Rotation.from_rotvec(rotvec)
    oracle = ENU_TO_NED * enu_from_flu * FLU_TO_FRD.inv()
    q = swap_attitude(wxyz(enu_from_flu))
    assert q[0] >= 0.0
    assert same_rotation(q, wxyz(oracle))
    assert same_rotation(swap_attitude(q), wxyz(enu_from_flu))


@given(st.floats(-math.pi, math.pi))
def test_a_heading_is_counted_from_north_clockwise(yaw: float) -> None:
    """A level drone that looks ``yaw`` left of east looks ``pi/2 - yaw`` right of north."""
    q = swap_attitude(wxyz(Rotation.from_euler("z", yaw)))
    ned = Rotation.from_quat(np.roll(q, -1)).as_euler("ZYX")
    assert math.cos(ned[0] - (math.pi / 2 - yaw)) == pytest.approx(1.0, abs=1e-9)
    assert ned[1:] == pytest.approx([0.0, 0.0], abs=1e-6)


@given(vectors, angles, vectors)
def test_points_go_the_same_way_by_either_pose(
    t: np.ndarray, rotvec: np.ndarray, p_flu: np.ndarray
) -> None:
    """A point of the body lands in the same place of the world, whichever axes one counts in."""
    world_from_body = Pose(t, wxyz(Rotation.from_rotvec(rotvec)))
    ned = swap_pose(world_from_body)
    assert np.allclose(
        swap_world(ned @ swap_body(p_flu)), world_from_body @ p_flu, rtol=0, atol=1e-9
    )


@given(st.floats(-2.0, 2.0))
def test_a_yaw_rate_turns_its_sign(rate: float) -> None:
    """The rotation by a small yaw about up is one by minus that about down."""
    assert swap_yaw_rate(rate) == -rate
    turned = Rotation.from_rotvec(ENU_TO_NED.apply([0.0, 0.0, rate])).as_rotvec()
    assert turned[2] == pytest.approx(swap_yaw_rate(rate))


@given(arrays(np.float64, (6, 6), elements=st.floats(-3.0, 3.0)))
def test_covariances_turn_with_the_errors_and_come_back(a: np.ndarray) -> None:
    """The turned covariance is that of turned errors; 21 numbers bring all of it back."""
    covariance = a @ a.T
    turn = ENU_TO_NED.as_matrix()
    both = np.block([[turn, np.zeros((3, 3))], [np.zeros((3, 3)), turn]])
    oracle = both @ covariance @ both.T
    triangle = triangle_from_covariance(covariance)
    assert np.allclose(triangle, oracle[np.triu_indices(6)], atol=1e-9)
    back = covariance_from_triangle(triangle)
    assert back is not None
    assert np.allclose(back, covariance, atol=1e-9)


def test_a_rotation_vector_about_the_world_turns_as_the_covariance_says() -> None:
    """Sampled: rotate attitudes by small errors in ENU, measure them in NED."""
    rng = np.random.default_rng(3)
    base = Rotation.from_rotvec([0.3, -0.8, 1.2])
    errors = rng.normal(size=(20000, 3)) * [1e-3, 2e-3, 3e-3]
    turned = []
    for r in errors[:2000]:
        q = swap_attitude(wxyz(Rotation.from_rotvec(r) * base))
        ned_base = Rotation.from_quat(np.roll(swap_attitude(wxyz(base)), -1))
        turned.append((Rotation.from_quat(np.roll(q, -1)) * ned_base.inv()).as_rotvec())
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = np.cov(errors[:2000].T)
    triangle = np.array(triangle_from_covariance(covariance))
    full = np.zeros((6, 6))
    full[np.triu_indices(6)] = triangle
    assert np.allclose(np.triu(np.cov(np.array(turned).T)), full[3:, 3:], atol=1e-10)


def test_unknown_covariances_are_none() -> None:
    """NaN in the first place, or anywhere, and a wrong length stand for "not known"."""
    assert covariance_from_triangle([math.nan] * 21) is None
    assert covariance_from_triangle([0.0] * 20 + [math.inf]) is None
    # PX4's own: the variances of north, east, down and of the turns about them, and nothing beside
    triangle = [math.nan] * 21
    for variance, i in enumerate((0, 6, 11, 15, 18, 20), 1):
        triangle[i] = variance
    of_px4 = covariance_from_triangle(triangle)
    assert of_px4 is not None
    assert of_px4.tolist() == np.diag([2, 1, 3, 5, 4, 6]).tolist()
    assert covariance_from_triangle([0.0] * 20) is None
