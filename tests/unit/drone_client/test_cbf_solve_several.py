"""Several half-spaces and a speed limit, against CVXPY, DAQP and the one-plane closed form."""

from __future__ import annotations

import math
import warnings

import cvxpy as cp
import daqp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_client.cbf import HalfSpace, Status, solve, solve_several

NONE = (0.0, 0.0, 0.0)
speeds = st.floats(-1, 1)
velocities = st.tuples(speeds, speeds, speeds)
normals = velocities.filter(lambda n: math.hypot(*n) > 0.01)
spaces = st.builds(HalfSpace, normals, st.floats(-0.5, 0.5))
anything = st.floats(allow_nan=True, allow_infinity=True)


def random_problem(rng: np.random.Generator):
    """Nominal velocity, half-spaces with unit normals, speed limit: some of them degenerate."""
    count = int(rng.integers(2, 9))
    normals = rng.normal(size=(count, 3))
    kind = rng.integers(5)
    if kind == 1:
        normals[1] = normals[0]  # parallel
    elif kind == 2:
        normals[1] = normals[0] + 1e-5 * rng.normal(size=3)  # nearly parallel
    elif kind == 3:
        normals[-1] = -normals[0]  # opposite
    elif kind == 4:
        normals[-1] = 0.3 * normals[0] + 0.7 * normals[1]  # one edge, three planes
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    offsets = rng.uniform(-0.4, 0.15, size=count)
    if kind == 1 and rng.integers(2):
        offsets[1] = offsets[0]  # the same plane twice
    nominal = rng.normal(size=3) * rng.choice([0.1, 0.5, 2.0])
    return nominal, normals, offsets, float(rng.uniform(0.1, 1.0))


def as_spaces(normals, offsets) -> list[HalfSpace]:
    return [HalfSpace(tuple(n.tolist()), float(b)) for n, b in zip(normals, offsets, strict=True)]


def conic(nominal, normals, offsets, v_max) -> tuple[str, np.ndarray | None]:
    """CVXPY's status and answer."""
    u = cp.Variable(3)
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares(u - nominal)), [normals @ u >= offsets, cp.norm(u) <= v_max]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it is not sure is in its status
        problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    return problem.status, u.value


def test_random_problems_agree_with_cvxpy() -> None:
    """The nearest velocity is CVXPY's, duplicates, parallels and common edges included."""
    rng, solved = np.random.default_rng(5), 0
    for _ in range(400):
        nominal, normals, offsets, v_max = random_problem(rng)
        found, theirs = conic(nominal, normals, offsets, v_max)
        half_spaces = as_spaces(normals, offsets)
        split = int(rng.integers(len(half_spaces) + 1))
        ours = solve_several(
            tuple(nominal.tolist()), half_spaces[:split], half_spaces[split:], v_max
        )
        if found == cp.INFEASIBLE:
            assert ours.status is Status.MAX_HDOT
        if found != cp.OPTIMAL:
            continue
        solved += 1
        assert ours.status in (Status.INACTIVE, Status.ACTIVE)
        u = np.array(ours.u)
        assert (normals @ u >= offsets - 1e-8).all()
        assert np.linalg.norm(u) <= v_max * (1 + 1e-12)
        # The distance is what is minimised; where the set is sharp the solver's u is less exact.
        assert np.linalg.norm(u - nominal) <= np.linalg.norm(theirs - nominal) + 1e-7
        np.testing.assert_allclose(u, theirs, rtol=0, atol=2e-5)
    assert solved > 200


def test_far_from_the_speed_limit_daqp_agrees() -> None:
    """With room in speed it is a quadratic program, and DAQP has the same answer to 1e-8."""
    rng, solved = np.random.default_rng(6), 0
    for _ in range(1000):
        nominal, normals, offsets, _ = random_problem(rng)
        m = len(offsets)
        u, _, flag, _ = daqp.solve(
            np.eye(3),
            -nominal,
            normals.copy(),
            np.full(m, 1e30),
            offsets.copy(),
            np.zeros(m, dtype=np.intc),
        )
        if flag != 1 or np.linalg.norm(u) > 50:
            continue
        solved += 1
        ours = solve_several(tuple(nominal.tolist()), as_spaces(normals, offsets), (), 100.0)
        gap = np.linalg.norm(np.array(ours.u) - nominal) - np.linalg.norm(u - nominal)
        assert abs(gap) < 1e-5  # DAQP's own tolerance on a constraint is 1e-6
        assert (normals @ np.array(ours.u) >= offsets - 1e-8).all()
    assert solved > 700


@given(velocities, spaces, st.floats(0, 1))
def test_one_wish_is_the_closed_form(u_nominal, half_space, v_max) -> None:
    """With nothing else to respect the answer is that of the one-plane solver, to the bit."""
    assert solve_several(u_nominal, (), (half_space,), v_max) == solve(u_nominal, half_space, v_max)


@given(velocities, st.lists(spaces, max_size=6), st.lists(spaces, max_size=2), st.floats(0, 1))
@settings(max_examples=300)
def test_the_order_within_a_rank_does_not_matter(u_nominal, keep_outs, wishes, v_max) -> None:
    """Keep-outs are all of one rank: listed backwards they give the same velocity."""
    one = solve_several(u_nominal, keep_outs, wishes, v_max)
    other = solve_several(u_nominal, keep_outs[::-1], wishes, v_max)
    assert one.status is other.status or Status.ABORT in (one.status, other.status)
    reach = [math.dist(s.u, u_nominal) for s in (one, other)]
    if one.status is not Status.MAX_HDOT:
        assert reach[0] == pytest.approx(reach[1], abs=1e-6)


def violation(u, half_spaces) -> float:
    missed = [(s.offset - np.dot(s.normal, u)) / np.linalg.norm(s.normal) for s in half_spaces]
    return max(0.0, *missed)


@settings(max_examples=200)
@given(
    velocities,
    st.lists(spaces, min_size=1, max_size=6),
    st.lists(spaces, max_size=2),
    st.floats(0, 1),
    st.integers(0, 2**32),
)
def test_where_nothing_fits_the_keep_outs_are_missed_least(
    u_nominal, keep_outs, wishes, v_max, seed
) -> None:
    """No velocity within the limit misses its worst keep-out by less than the answer does."""
    u, _ = solve_several(u_nominal, keep_outs, wishes, v_max)
    worst = violation(u, keep_outs)
    rng = np.random.default_rng(seed)
    near = np.array(u) + rng.normal(size=(100, 3)) * rng.choice([1e-6, 1e-3, 0.3], size=(100, 1))
    for there in near:
        there *= min(1.0, v_max / max(np.linalg.norm(there), 1e-300))
        assert violation(there, keep_outs) >= worst - 5e-9


def test_floor_and_ceiling_share_what_is_too_little() -> None:
    """Two planes that ask for opposite velocities are missed by the same, and the wish is met."""
    floor, ceiling = HalfSpace((0.0, 0.0, 1.0), 0.1), HalfSpace((0.0, 0.0, -1.0), 0.3)
    funnel = HalfSpace((1.0, 0.0, 0.0), 0.05)
    u, status = solve_several((-0.2, 0.1, 0.0), (floor, ceiling), (funnel,), 0.4)
    assert status is Status.MAX_HDOT
    assert u == pytest.approx((0.05, 0.1, -0.1), abs=1e-8)


def test_a_keep_out_outranks_a_wish() -> None:
    """Where the funnel asks for what a wall behind forbids, the wall is kept to the full."""
    wall, funnel = HalfSpace((-1.0, 0.0, 0.0), 0.0), HalfSpace((1.0, -1.0, 0.0), 1.0)
    u, status = solve_several((0.1, 0.1, 0.1), (wall,), (funnel,), 0.4)
    assert status is Status.MAX_HDOT
    assert u == pytest.approx((0.0, -0.4, 0.0), abs=1e-8)  # all the speed where it still helps


def test_what_a_wish_leaves_open_is_as_wanted() -> None:
    """A wish that is blocked altogether leaves the rest of the nominal velocity as it was."""
    wall, funnel = HalfSpace((-1.0, 0.0, 0.0), 0.0), HalfSpace((1.0, 0.0, 0.0), 0.1)
    u, status = solve_several((0.1, 0.1, 0.2), (wall,), (funnel,), 0.4)
    assert status is Status.MAX_HDOT
    assert u == pytest.approx((0.0, 0.1, 0.2), abs=1e-8)


def test_a_corner_of_three_planes_is_found() -> None:
    """Floor, side wall and board at once: the velocity in the corner of all three."""
    planes = [
        HalfSpace(tuple(float(i == axis) for i in range(3)), 0.01 * (axis + 1)) for axis in range(3)
    ]
    u, status = solve_several((-0.1, -0.1, -0.1), planes, (), 0.4)
    assert status is Status.ACTIVE
    assert u == pytest.approx((0.01, 0.02, 0.03), abs=1e-12)


@settings(max_examples=500)
@given(
    st.tuples(anything, anything, anything),
    st.lists(st.builds(HalfSpace, st.tuples(anything, anything, anything), anything), max_size=4),
    st.lists(spaces | st.builds(HalfSpace, velocities, anything), max_size=3),
    anything,
)
def test_whatever_the_numbers_are_there_is_a_velocity_within_the_limit(
    u_nominal, keep_outs, wishes, v_max
) -> None:
    """NaN, infinity, zero normals and negative limits give a finite velocity and a status."""
    u, status = solve_several(u_nominal, keep_outs, wishes, v_max)
    assert all(math.isfinite(c) for c in u)
    assert isinstance(status, Status)
    assert math.hypot(*u) <= (v_max if v_max >= 0 else 0.0) * (1 + 1e-12)


def test_no_speed_is_no_motion() -> None:
    """With v_max = 0 the answer is zero, and it says whether that is enough."""
    near, far = HalfSpace((1.0, 0.0, 0.0), -0.1), HalfSpace((0.0, 1.0, 0.0), 0.1)
    assert solve_several((1.0, 0.0, 0.0), (near,), (), 0.0) == (NONE, Status.INACTIVE)
    assert solve_several((1.0, 0.0, 0.0), (near, far), (), 0.0) == (NONE, Status.MAX_HDOT)
