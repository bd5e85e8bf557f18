"""The closed form against CVXPY, DAQP and its own optimality conditions."""

from __future__ import annotations

import math

import cvxpy as cp
import daqp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import nnls

from drone_client.cbf import FilterSettings, Funnel, HalfSpace, Status, alpha, build, solve

anything = st.floats(allow_nan=True, allow_infinity=True, width=64)
speeds = st.floats(-3, 3)
velocities = st.tuples(speeds, speeds, speeds)
normals = velocities.filter(lambda n: math.hypot(*n) > 0.01)


class Stack:
    """Random problems, as arrays of one row each; every normal has unit length."""

    def __init__(self, n: int, seed: int) -> None:
        """Half of them from random states of the funnel, half with any normal and offset."""
        rng = np.random.default_rng(seed)
        settings, half_spaces = FilterSettings(), []
        for i in range(n):
            if i % 2:
                half_space = HalfSpace(tuple(rng.normal(size=3)), rng.uniform(-1.5, 1.5))
            else:
                p = tuple(rng.uniform((0, -1, -1), (3, 1, 1)) * rng.choice([1, 0.1]))
                half_space = build(Funnel(), p, rng.uniform(0, 0.03), 0.01, alpha(p, settings))
            half_spaces.append(half_space)
        normal = np.array([half_space.normal for half_space in half_spaces])
        length = np.linalg.norm(normal, axis=1)
        self.half_spaces = half_spaces
        self.normal = normal / length[:, None]  # (n, 3)
        self.offset = np.array([half_space.offset for half_space in half_spaces]) / length  # (n,)
        self.nominal = rng.normal(size=(n, 3)) * rng.choice([0.1, 0.5, 2.0], size=(n, 1))
        self.v_max = rng.uniform(0.05, 1.0, size=n)
        self.feasible = self.offset <= self.v_max

    def ours(self, rows: NDArray[np.intp]) -> tuple[NDArray[np.float64], set[Status]]:
        solutions = [
            solve(tuple(self.nominal[i].tolist()), self.half_spaces[i], float(self.v_max[i]))
            for i in rows
        ]
        return np.array([s.u for s in solutions]), {s.status for s in solutions}


def cvxpy_solve(objective: cp.Expression, constraints: list[cp.Constraint]) -> None:
    problem = cp.Problem(cp.Minimize(objective), constraints)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    assert problem.status == cp.OPTIMAL


def test_ten_thousand_random_problems_agree_with_cvxpy() -> None:
    """The nearest safe velocity is CVXPY's to 1e-6, and so is the steepest where none is safe.

    The problems share no variable, so a stack of thousands is one program with their solutions.
    Where a constraint is barely active the solver is off by 4e-6 at its tolerance of 1e-10, by
    less than 1e-6 at 1e-11.
    """
    stack = Stack(10_000, seed=1)
    assert 0.5 < stack.feasible.mean() < 0.9
    for rows in np.array_split(np.flatnonzero(stack.feasible), 3):
        u = cp.Variable((len(rows), 3))
        cvxpy_solve(
            cp.sum(cp.norm(u - stack.nominal[rows], axis=1)),
            [
                cp.sum(cp.multiply(stack.normal[rows], u), axis=1) >= stack.offset[rows],
                cp.norm(u, axis=1) <= stack.v_max[rows],
            ],
        )
        ours, statuses = stack.ours(rows)
        assert statuses == {Status.INACTIVE, Status.ACTIVE}
        np.testing.assert_allclose(ours, u.value, rtol=0, atol=1e-6)
    for rows in np.array_split(np.flatnonzero(~stack.feasible), 3):
        u = cp.Variable((len(rows), 3))
        cvxpy_solve(
            -cp.sum(cp.multiply(stack.normal[rows], u)),
            [cp.norm(u, axis=1) <= stack.v_max[rows]],
        )
        ours, statuses = stack.ours(rows)
        assert statuses == {Status.MAX_HDOT}
        np.testing.assert_allclose(ours, u.value, rtol=0, atol=1e-6)


def test_far_from_the_speed_limit_daqp_agrees() -> None:
    """With room in speed the problem is a quadratic program with one row, and DAQP solves it."""
    stack = Stack(500, seed=2)
    for i in range(500):
        u, _, flag, _ = daqp.solve(
            np.eye(3),
            -stack.nominal[i],
            stack.normal[i][None, :].copy(),
            np.array([1e30]),
            np.array([stack.offset[i]]),
            np.array([0], dtype=np.intc),
        )
        assert flag == 1
        ours = solve(tuple(stack.nominal[i].tolist()), stack.half_spaces[i], 1e3)
        np.testing.assert_allclose(ours.u, u, rtol=0, atol=1e-9)


@settings(max_examples=500)
@given(velocities, normals, st.floats(-3, 3), st.floats(0.01, 2))
def test_the_solution_meets_its_optimality_conditions(u_nominal, normal, offset, v_max) -> None:
    """It is feasible, and stationary with non-negative multipliers on what is active (KKT)."""
    solution = solve(u_nominal, HalfSpace(normal, offset), v_max)
    length = math.hypot(*normal)
    u, n, d = np.array(solution.u), np.array(normal) / length, offset / length
    assert np.linalg.norm(u) <= v_max + 1e-12
    if d > v_max:
        assert solution.status is Status.MAX_HDOT
        np.testing.assert_allclose(u, v_max * n, atol=1e-12)
        return
    assert n @ u >= d - 1e-12
    # u - u_nominal = lambda n - mu u, lambda and mu >= 0, each only where its constraint is active.
    columns = [
        column
        for column, active in (
            (n, n @ u - d < 1e-9),
            (-u, v_max - np.linalg.norm(u) < 1e-9),
        )
        if active
    ]
    step = u - np.array(u_nominal)
    residual = nnls(np.array(columns).T, step)[1] if columns else np.linalg.norm(step)
    # Where the circle shrinks to a point its two normals become one, and the multipliers unbounded.
    radius = math.sqrt(max(v_max**2 - d**2, 0.0))
    assert residual <= (1e-12 if radius > 1e-2 else 1e-4)


@given(velocities, normals, st.floats(-3, 3), st.floats(0, 2), st.floats(0, 1))
def test_no_safe_velocity_is_nearer(u_nominal, normal, offset, v_max, s) -> None:
    """No point on the way from the solution to the nominal velocity is safe as well."""
    half_space = HalfSpace(normal, offset)
    u, status = solve(u_nominal, half_space, v_max)
    if status is Status.MAX_HDOT:
        return
    there = np.array(u) + s * (np.array(u_nominal) - np.array(u))
    safe = np.linalg.norm(there) <= v_max and np.dot(normal, there) >= offset
    assert not safe or np.linalg.norm(there - np.array(u)) < 1e-6


@settings(max_examples=500)
@given(
    st.tuples(anything, anything, anything),
    st.tuples(anything, anything, anything),
    anything,
    anything,
)
def test_whatever_the_numbers_are_there_is_a_velocity_within_the_limit(
    u_nominal, normal, offset, v_max
) -> None:
    """NaN, infinity, the zero normal and negative limits give a finite velocity and a status."""
    u, status = solve(u_nominal, HalfSpace(normal, offset), v_max)
    assert all(math.isfinite(c) for c in u)
    assert isinstance(status, Status)
    limit = v_max if v_max >= 0 else 0.0
    assert math.hypot(*u) <= limit * (1 + 1e-12)


def test_no_speed_is_no_motion() -> None:
    """With v_max = 0 the answer is zero, and it says whether that is enough."""
    assert solve((1.0, 0.0, 0.0), HalfSpace((1.0, 0.0, 0.0), -0.1), 0.0) == (
        (0.0, 0.0, 0.0),
        Status.INACTIVE,
    )
    assert solve((1.0, 0.0, 0.0), HalfSpace((1.0, 0.0, 0.0), 0.1), 0.0) == (
        (0.0, 0.0, 0.0),
        Status.MAX_HDOT,
    )


def test_a_half_space_without_a_direction_stops() -> None:
    """A zero normal, or a number that is none, is ABORT with zero velocity."""
    for half_space in (HalfSpace((0.0, 0.0, 0.0), -1.0), HalfSpace((math.nan, 0.0, 0.0), 0.0)):
        assert solve((0.1, 0.0, 0.0), half_space, 0.4) == ((0.0, 0.0, 0.0), Status.ABORT)


def test_the_half_space_is_the_barriers_condition() -> None:
    """On its edge dh/dt = -alpha h exactly, with the growth of the error ball in it."""
    funnel, p, delta, rate, gain = Funnel(), (0.3, 0.02, -0.01), 0.012, 0.01, 1.2
    normal, offset = build(funnel, p, delta, rate, gain)
    u = np.array(normal) * offset / np.dot(normal, normal)
    dt = 1e-6
    p_next = tuple(np.array(p) + dt * u)
    slope = (funnel.h(p_next, delta + rate * dt) - funnel.h(p, delta)) / dt
    assert abs(slope + gain * funnel.h(p, delta)) < 1e-4
