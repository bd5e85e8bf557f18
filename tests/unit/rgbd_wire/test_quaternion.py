"""Quaternions as tuples: the same as SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rgbd_wire.quaternion import (
    about_up,
    conjugate,
    from_vector,
    product,
    rotate,
    rotate_back,
    to_vector,
)

numbers = st.floats(-3.0, 3.0)
vectors = st.tuples(numbers, numbers, numbers)


def _of(q) -> Rotation:
    w, x, y, z = q
    return Rotation.from_quat([x, y, z, w])


@given(vectors, vectors)
def test_a_vector_turns_as_scipy_turns_it_and_back(turn, v):
    """Rotating is SciPy's, rotating back undoes it."""
    q = from_vector(turn)
    assert rotate(q, v) == pytest.approx(Rotation.from_rotvec(turn).apply(v), abs=1e-12)
    assert rotate_back(q, rotate(q, v)) == pytest.approx(v, abs=1e-12)


@given(vectors, vectors)
def test_a_product_is_one_turn_after_the_other(first, second):
    """The product is SciPy's, and of unit length."""
    q = product(from_vector(second), from_vector(first))
    expected = Rotation.from_rotvec(second) * Rotation.from_rotvec(first)
    assert (_of(q) * expected.inv()).magnitude() == pytest.approx(0.0, abs=1e-7)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-12)
    assert product(q, conjugate(q)) == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-12)


@given(vectors)
def test_a_rotation_vector_comes_back_the_short_way(turn):
    """To and from rotation vectors, also those of almost no angle."""
    for v in (turn, tuple(1e-6 * c for c in turn)):
        assert to_vector(from_vector(v)) == pytest.approx(
            Rotation.from_rotvec(v).as_rotvec(), abs=1e-7
        )


def test_a_turn_about_up_leads_from_east_to_north():
    """Counter-clockwise, seen from above."""
    assert rotate(about_up(np.pi / 2), (1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))
