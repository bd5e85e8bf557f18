"""Rotations, quaternions and poses against scipy, and the axioms of the rigid transforms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import (
    UNIT_QUATERNION_TOLERANCE,
    Pose,
    quaternion_from_rotation,
    quaternion_product,
    rotation_from_quaternion,
    rotation_from_vector,
    skew,
    slerp,
    vector_from_rotation,
)

IDENTITY_Q = np.array([1.0, 0.0, 0.0, 0.0])


def unit(numbers):
    v = np.array(numbers)
    return v / np.linalg.norm(v)


def numbers(count, bound):
    return st.tuples(*[st.floats(-bound, bound)] * count).map(np.array)


quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 1e-3).map(unit)
vectors = numbers(3, 100.0)
poses = st.builds(Pose, vectors, quaternions)
fractions = st.floats(0, 1)


def scipy_of(q_wxyz):
    return Rotation.from_quat(q_wxyz, scalar_first=True)


def assert_same_rotation(p_wxyz, q_wxyz, atol=1e-9):
    """``q`` and ``-q`` are one rotation."""
    sign = 1.0 if p_wxyz @ q_wxyz > 0 else -1.0
    np.testing.assert_allclose(p_wxyz, sign * q_wxyz, atol=atol)


def assert_same_pose(a, b, atol=1e-9):
    np.testing.assert_allclose(a.matrix, b.matrix, atol=atol)


@given(vectors, vectors)
def test_skew_is_the_cross_product(v, w):
    """``skew(v) @ w`` is ``v x w``."""
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), atol=1e-9)


@given(quaternions)
def test_rotation_of_a_quaternion(q):
    """A quaternion turns into the matrix that scipy gives."""
    np.testing.assert_allclose(rotation_from_quaternion(q), scipy_of(q).as_matrix(), atol=1e-12)


@given(quaternions)
def test_quaternion_of_a_rotation(q):
    """The way back gives the same rotation, of unit length and with ``w >= 0``."""
    back = quaternion_from_rotation(scipy_of(q).as_matrix())
    assert back[0] >= 0
    assert np.linalg.norm(back) == pytest.approx(1, abs=1e-12)
    assert_same_rotation(back, q)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (-1, 2, 3)])
@pytest.mark.parametrize("gap_rad", [0.0, 1e-12, 1e-7])
def test_quaternion_of_half_a_turn(axis, gap_rad):
    """Half a turn, where ``w`` vanishes, loses no digits."""
    q = np.concatenate([[math.sin(gap_rad / 2)], math.cos(gap_rad / 2) * unit(axis)])
    assert_same_rotation(quaternion_from_rotation(scipy_of(q).as_matrix()), q)


@given(numbers(3, 2 * math.pi))
def test_rotation_of_a_rotation_vector(v):
    """Rodrigues' formula gives scipy's matrix."""
    expected = Rotation.from_rotvec(v).as_matrix()
    np.testing.assert_allclose(rotation_from_vector(v), expected, atol=1e-12)


@pytest.mark.parametrize("angle_rad", [1e-12, 1e-9, 1e-8, 1e-7, 1e-5, 1e-4, 1e-3, 1e-2])
def test_rotation_of_a_small_rotation_vector(angle_rad):
    """Where its fractions turn into 0/0, Rodrigues' formula keeps all digits."""
    v = angle_rad * unit((1.0, -2.0, 3.0))
    expected = Rotation.from_rotvec(v).as_matrix()
    np.testing.assert_allclose(rotation_from_vector(v), expected, rtol=0, atol=1e-15)


@given(quaternions)
def test_rotation_vector_of_a_rotation(q):
    """The rotation vector is at most half a turn long and gives the rotation back."""
    rotation = scipy_of(q).as_matrix()
    v = vector_from_rotation(rotation)
    assert np.linalg.norm(v) <= math.pi + 1e-12
    np.testing.assert_allclose(Rotation.from_rotvec(v).as_matrix(), rotation, atol=1e-9)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-15, 1e-12, 1e-9, 1e-8, 1e-7, 1e-5, 3.14159])
def test_small_rotation_vectors_survive(angle_rad):
    """From nothing to almost half a turn, a rotation vector comes back as it was."""
    v = angle_rad * unit((1.0, -2.0, 3.0))
    back = vector_from_rotation(rotation_from_vector(v))
    np.testing.assert_allclose(back, v, rtol=1e-6, atol=1e-15)


@given(quaternions, quaternions)
def test_quaternion_product(p, q):
    """The product is the composition of rotations, and rounding does not add up in its length."""
    expected = (scipy_of(p) * scipy_of(q)).as_quat(scalar_first=True)
    assert_same_rotation(quaternion_product(p, q), expected)
    assert np.linalg.norm(quaternion_product(1.0005 * p, q)) == pytest.approx(1, abs=1e-12)


@given(quaternions, quaternions, fractions)
def test_slerp_is_scipys(p, q, s):
    """SLERP agrees with scipy's, wherever the short way is not a matter of the last digit."""
    assume(abs(p @ q) > 1e-6)
    between = Slerp([0, 1], Rotation.concatenate([scipy_of(p), scipy_of(q)]))
    assert_same_rotation(slerp(p, q, s), between(s).as_quat(scalar_first=True), atol=1e-6)


@given(quaternions, quaternions)
def test_slerp_meets_its_ends(p, q):
    """At 0 and 1 it is one end and the other."""
    assert_same_rotation(slerp(p, q, 0.0), p)
    assert_same_rotation(slerp(p, q, 1.0), q)


@given(quaternions, quaternions, fractions)
def test_slerp_goes_the_short_way_whatever_the_sign(p, q, s):
    """``q`` and ``-q`` are the same end, and no point on the way is further than the ends are."""
    assume(abs(p @ q) > 1e-6)
    between = slerp(p, q, s)
    assert_same_rotation(between, slerp(p, -q, s))
    whole = scipy_of(p).inv() * scipy_of(q)
    part = scipy_of(p).inv() * scipy_of(between)
    assert part.magnitude() == pytest.approx(s * whole.magnitude(), abs=1e-5)


@given(poses, poses, poses)
def test_composition_is_associative(a, b, c):
    """``(a @ b) @ c`` is ``a @ (b @ c)``."""
    assert_same_pose((a @ b) @ c, a @ (b @ c))


@given(poses)
def test_identity_changes_nothing(a):
    """The identity is neutral on both sides."""
    assert_same_pose(a @ Pose.identity(), a)
    assert_same_pose(Pose.identity() @ a, a)


@given(poses)
def test_inverse_undoes_on_both_sides(a):
    """A pose times its inverse is the identity, and the inverse is the matrix's."""
    assert_same_pose(a @ a.inverse(), Pose.identity())
    assert_same_pose(a.inverse() @ a, Pose.identity())
    np.testing.assert_allclose(a.inverse().matrix, np.linalg.inv(a.matrix), atol=1e-9)


@given(poses, poses)
def test_composition_is_the_product_of_matrices(a, b):
    """``a @ b`` has the matrix ``A B``."""
    np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-9)


@given(poses, poses, vectors)
def test_points_go_through_one_transform_at_a_time(a, b, p):
    """``(a @ b) @ p`` is ``a @ (b @ p)``, and is what the homogeneous matrix says."""
    np.testing.assert_allclose((a @ b) @ p, a @ (b @ p), atol=1e-9)
    np.testing.assert_allclose(a @ p, (a.matrix @ [*p, 1.0])[:3], atol=1e-9)


@given(poses, st.lists(vectors, min_size=0, max_size=5))
def test_many_points_at_once(a, points):
    """Points (N, 3) map row by row."""
    rows = np.array(points).reshape(-1, 3)
    mapped = a @ rows
    assert mapped.shape == rows.shape
    for row, point in zip(mapped, points, strict=True):
        np.testing.assert_allclose(row, a @ point, atol=1e-9)


@given(poses, vectors, vectors)
def test_distances_stay(a, p, q):
    """A rigid transform keeps distances, and right hands right."""
    assert np.linalg.norm(a @ p - a @ q) == pytest.approx(np.linalg.norm(p - q), abs=1e-9)
    assert np.linalg.det(a.rotation) == pytest.approx(1)


@given(poses, poses, fractions)
def test_interpolation(a, b, s):
    """Positions go straight, rotations go by SLERP, the ends are the poses themselves."""
    between = a.interpolate(b, s)
    expected = (1 - s) * a.translation + s * b.translation
    np.testing.assert_allclose(between.translation, expected, atol=1e-9)
    assert_same_rotation(between.q_wxyz, slerp(a.q_wxyz, b.q_wxyz, s))
    assert_same_pose(a.interpolate(b, 0.0), a)
    assert_same_pose(a.interpolate(b, 1.0), b)


@given(poses, poses)
def test_turned_since_leads_from_one_attitude_to_the_other(a, b):
    """The rotation vector turns the other attitude into this one, the short way."""
    turn = np.array(b.turned_since(a))
    assert np.linalg.norm(turn) <= math.pi + 1e-12
    np.testing.assert_allclose(rotation_from_vector(turn) @ a.rotation, b.rotation, atol=1e-9)


@given(poses)
def test_matrix_round_trip(a):
    """``from_matrix`` and ``from_rotation`` undo ``matrix`` and ``rotation``."""
    assert_same_pose(Pose.from_matrix(a.matrix), a)
    assert_same_pose(Pose.from_rotation(a.rotation, a.translation), a)


def test_long_chains_stay_rigid():
    """Ten thousand compositions leave a rotation that is still one."""
    step = Pose(np.array([0.01, 0.0, -0.02]), unit((1.0, 0.01, -0.02, 0.03)))
    pose = Pose.identity()
    for _ in range(10_000):
        pose = pose @ step
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)


def test_names_cancel():
    """A camera that looks east sees what lies north on its left: docs/frames.md in numbers."""
    world_from_camera = Pose(np.array([0.0, 0.0, 1.0]), np.array([0.5, -0.5, 0.5, -0.5]))
    p_world = np.array([10.0, 2.0, 1.5])  # ahead, to the left, half a metre higher
    p_camera = world_from_camera.inverse() @ p_world
    np.testing.assert_allclose(p_camera, [-2.0, -0.5, 10.0], atol=1e-12)


@pytest.mark.parametrize(
    ("translation", "q_wxyz", "complaint"),
    [
        (np.zeros(2), IDENTITY_Q, "shapes"),
        (np.zeros(3), np.array([1.0, 0.0, 0.0]), "shapes"),
        (np.zeros((3, 1)), IDENTITY_Q, "shapes"),
        (np.array([0.0, np.nan, 0.0]), IDENTITY_Q, "finite"),
        (np.array([np.inf, 0.0, 0.0]), IDENTITY_Q, "finite"),
        (np.zeros(3), np.array([np.nan, 0.0, 0.0, 0.0]), "finite"),
        (np.zeros(3), np.full(4, np.nan), "finite"),
        (np.zeros(3), np.zeros(4), "unit length"),
        (np.zeros(3), 1.01 * IDENTITY_Q, "unit length"),
        (np.zeros(3), 0.99 * IDENTITY_Q, "unit length"),
    ],
)
def test_impossible_poses_are_refused(translation, q_wxyz, complaint):
    """Wrong shapes, numbers that are none, and quaternions that are no rotation."""
    with pytest.raises(GeometryError, match=complaint):
        Pose(translation, q_wxyz)


def test_a_quaternion_off_by_rounding_is_normalised():
    """Within the tolerance it is a rounding error, not a mistake."""
    pose = Pose(np.zeros(3), (1 + 0.9 * UNIT_QUATERNION_TOLERANCE) * IDENTITY_Q)
    assert np.linalg.norm(pose.q_wxyz) == pytest.approx(1, abs=1e-15)


def test_a_pose_keeps_its_own_read_only_numbers():
    """Nobody changes a pose from outside, neither through its inputs nor through its fields."""
    t = np.array([1.0, 2.0, 3.0])
    pose = Pose(t, IDENTITY_Q)
    t[0] = 99.0
    assert pose.translation[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        pose.translation[0] = 5.0
    with pytest.raises(ValueError, match="read-only"):
        pose.q_wxyz[0] = 5.0


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(3),
        np.diag([1.0, 1.0, -1.0, 1.0]),  # a mirror
        np.diag([2.0, 2.0, 2.0, 1.0]),
        np.diag([1.0, 1.0, 1.0, 2.0]),
        np.full((4, 4), np.nan),
        np.zeros((4, 4)),
    ],
)
def test_matrices_that_are_no_rigid_transform(matrix):
    """Mirrors, scalings, projections and holes are refused."""
    with pytest.raises(GeometryError):
        Pose.from_matrix(matrix)
