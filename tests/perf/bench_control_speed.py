"""How long the safety filter takes beside solvers of the same problem, and whether they agree.

The rounds alternate between the contenders, so that a slow moment of the machine hits all of them.
Times are wall time per call.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import daqp
import numpy as np
import osqp
import scipy.sparse as sp

from drone_client.cbf import (
    FilterInput,
    FilterSettings,
    HalfSpace,
    Status,
    build,
    filter_command,
    solve,
    solve_several,
)
from drone_client.cbf.vector import Vec3
from tests.perf.bench_control_trials import WALL

SETTINGS = FilterSettings()
V_MAX = SETTINGS.v_max_mps
DELTA_M = 0.012
FACING = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
"""``target_from_body`` of a level body that looks at the board."""
PLANES = (
    HalfSpace((1.0, 0.0, 0.0), -0.1),
    HalfSpace((0.0, 0.0, 1.0), -0.05),
    HalfSpace((0.0, 0.0, -1.0), -0.1),
)
"""A wall, a floor and a ceiling, near enough to matter."""
Solver = Callable[["Case"], np.ndarray | None]


@dataclass(frozen=True)
class Case:
    """One problem, in the form each contender takes."""

    inp: FilterInput
    u_nominal: Vec3
    half_space: HalfSpace


def random_cases(n: int) -> list[Case]:
    """Feasible states of the funnel, inside it and a little outside."""
    rng, cases = np.random.default_rng(3), []
    while len(cases) < n:
        p = tuple(rng.uniform((0.05, -0.2, -0.2), (1.5, 0.2, 0.2)).tolist())
        u = tuple((0.4 * rng.normal(size=3)).tolist())
        half_space = build(SETTINGS.funnel, p, DELTA_M, 0.0, 1.2)
        if half_space.offset <= 0.95 * V_MAX * float(np.linalg.norm(half_space.normal)):
            arm, up = (-0.55, 0.0, 0.0), (0.0, 0.0, 1.0)
            inp = FilterInput(p, u, 0.1, arm, up, 100_000_000, 0.5, 0.0005)
            cases.append(Case(inp, u, half_space))
    return cases


def cvxpy_rebuilt(case: Case) -> np.ndarray | None:
    """The paper's problem as it reads, with the speed limit: built and solved every tick."""
    u = cp.Variable(3)
    constraints = [
        np.array(case.half_space.normal) @ u >= case.half_space.offset,
        cp.norm(u) <= V_MAX,
    ]
    cp.Problem(cp.Minimize(cp.sum_squares(u - np.array(case.u_nominal))), constraints).solve()
    return u.value


def cvxpy_parametrised(**options: Any) -> Solver:
    """The same problem compiled once, its numbers as parameters (CVXPY's DPP)."""
    u, nominal, normal, offset = cp.Variable(3), cp.Parameter(3), cp.Parameter(3), cp.Parameter()
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares(u - nominal)), [normal @ u >= offset, cp.norm(u) <= V_MAX]
    )

    def run(case: Case) -> np.ndarray | None:
        nominal.value = np.array(case.u_nominal)
        normal.value = np.array(case.half_space.normal)
        offset.value = case.half_space.offset
        problem.solve(**options)
        return u.value

    return run


def cvxpy_polished() -> Solver:
    """CVXPY's answer at its sharpest, and two steps of Newton's on the conditions that it found.

    An interior point stops where many velocities are nearly as good: 1e-6 before the sphere. Which
    constraints are active it knows well, and they say the rest; OSQP calls this polishing.
    """
    u, nominal, normal, offset = cp.Variable(3), cp.Parameter(3), cp.Parameter(3), cp.Parameter()
    plane, ball = normal @ u >= offset, cp.norm(u) <= V_MAX
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(u - nominal)), [plane, ball])
    options = {f"tol_{name}": 1e-13 for name in ("gap_abs", "gap_rel", "feas", "ktratio")}

    def run(case: Case) -> np.ndarray | None:
        n, b = np.array(case.half_space.normal), case.half_space.offset
        nominal.value, normal.value, offset.value = np.array(case.u_nominal), n, b
        problem.solve(solver=cp.CLARABEL, **options)
        if u.value is None:
            return None
        x = u.value.copy()
        force = float(plane.dual_value)  # u - u_0 = force n - press u / |u|
        press = float(np.ravel(ball.dual_value)[0])
        on_plane, on_ball = force > n @ x - b, press > V_MAX - np.linalg.norm(x)
        stretch = press / V_MAX
        for _ in range(2):
            residual = [x - nominal.value - force * on_plane * n + stretch * on_ball * x]
            jacobian = np.zeros((5, 5))
            jacobian[:3, :3] = (1.0 + stretch * on_ball) * np.eye(3)
            jacobian[:3, 3], jacobian[:3, 4] = -n * on_plane, x * on_ball
            jacobian[3, :3], jacobian[4, :3] = n * on_plane, x * on_ball
            jacobian[3, 3], jacobian[4, 4] = not on_plane, not on_ball
            residual += [[(n @ x - b) * on_plane], [0.5 * (x @ x - V_MAX**2) * on_ball]]
            step = np.linalg.lstsq(jacobian, -np.concatenate(residual), rcond=None)[0]
            x, force, stretch = x + step[:3], force + step[3], stretch + step[4]
        return x

    return run


def by_daqp(case: Case) -> np.ndarray | None:
    """Half-space and a box as wide as the ball: a quadratic program knows no ball."""
    u, _, flag, _ = daqp.solve(
        np.eye(3),
        -np.array(case.u_nominal),
        np.array([case.half_space.normal]),
        np.array([V_MAX, V_MAX, V_MAX, 1e30]),
        np.array([-V_MAX, -V_MAX, -V_MAX, case.half_space.offset]),
        np.zeros(4, dtype=np.intc),
    )
    return u if flag == 1 else None


def by_osqp() -> Solver:
    """The same quadratic program, set up once and updated."""
    shape = sp.csc_matrix(np.vstack([np.eye(3), np.ones((1, 3))]))
    solver = osqp.OSQP()
    low, high = np.array([-V_MAX] * 3 + [0.0]), np.array([V_MAX] * 3 + [np.inf])
    options = {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 20_000, "verbose": False}
    solver.setup(sp.eye(3, format="csc"), np.zeros(3), shape, low, high, **options)
    values = shape.copy()
    slots = np.flatnonzero(values.indices == 3)

    def run(case: Case) -> np.ndarray | None:
        values.data[slots] = case.half_space.normal
        low[3] = case.half_space.offset
        solver.update(q=-np.array(case.u_nominal), l=low, Ax=values.data)
        return np.asarray(solver.solve(raise_error=False).x)

    return run


def agreement(n: int) -> dict[str, Any]:
    """How far others' answers are from the closed form's."""
    contenders: dict[str, Solver] = {
        "CVXPY, polished": cvxpy_polished(),
        "CVXPY, as it stops": cvxpy_parametrised(solver=cp.CLARABEL),
        "DAQP": by_daqp,
        "OSQP": by_osqp(),
    }
    off: dict[str, list[tuple[float, float]]] = {name: [] for name in contenders}
    for case in random_cases(n):
        ours, status = solve(case.u_nominal, case.half_space, V_MAX)
        if status is Status.MAX_HDOT:
            continue
        u, wanted = np.array(ours), np.array(case.u_nominal)
        for name, run in contenders.items():
            if "CVXPY" not in name and math.hypot(*ours) > V_MAX * (1 - 1e-9):
                continue  # the ball is what limits it, and they do not know it
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # "may be inaccurate": that is what is measured
                theirs = run(case)
            if theirs is not None:
                distances = (float(np.linalg.norm(x - wanted)) for x in (u, theirs))
                off[name].append((float(np.abs(u - theirs).max()), abs(np.subtract(*distances))))
    return {
        name: {
            "problems": len(pairs),
            "within_1e-8": sum(a <= 1e-8 for a, _ in pairs) / max(1, len(pairs)),
            "p50": float(np.median([a for a, _ in pairs])) if pairs else math.nan,
            "max": max((a for a, _ in pairs), default=math.nan),
            "distance_max": max((b for _, b in pairs), default=math.nan),
        }
        for name, pairs in off.items()
    }


def speed(rounds: int, share: float, step: Callable[[int], None]) -> list[dict[str, Any]]:
    """Median, p99 and the ratio of medians to CVXPY's (DPP): of the rounds, with their spread."""
    planes = (WALL, replace(WALL, name="floor", normal=(0.0, 0.0, 1.0), offset_m=-0.8))
    kept_out: dict[int, FilterInput] = {}

    def with_planes(case: Case) -> object:
        return filter_command(kept_out[id(case)], SETTINGS)

    contenders: list[tuple[str, Callable[[Case], object], int]] = [
        ("CVXPY, compiled once (DPP)", cvxpy_parametrised(), 60),
        ("CVXPY, built every tick", cvxpy_rebuilt, 15),
        ("OSQP, half-space and box", by_osqp(), 200),
        ("DAQP, half-space and box", by_daqp, 1_000),
        ("`solve`: the same problem", lambda c: solve(c.u_nominal, c.half_space, V_MAX), 5_000),
        ("`filter_command`: the whole tick", lambda c: filter_command(c.inp, SETTINGS), 3_000),
        (
            "`solve_several`: and three planes",
            lambda c: solve_several(c.u_nominal, PLANES, (c.half_space,), V_MAX),
            1_000,
        ),
        ("`filter_command`: wall and floor, four propellers each", with_planes, 1_000),
    ]
    cases = random_cases(max(2, round(share * 5_000)))
    for case in cases:
        kept_out[id(case)] = replace(case.inp, keep_outs=planes, target_from_body=FACING)
    times: list[list[np.ndarray]] = [[] for _ in contenders]
    for number in range(rounds + 1):
        for (_, run, n), found in zip(contenders, times, strict=True):
            wall_us = []
            for case in cases[: max(2, round(share * n))]:
                start = time.perf_counter_ns()
                run(case)
                wall_us.append((time.perf_counter_ns() - start) / 1e3)
            if number:  # the first warms up
                found.append(np.array(wall_us))
        step(number)
    first = [float(np.median(r)) for r in times[0]]
    rows = []
    for (name, _, _), found in zip(contenders, times, strict=True):
        ratios = [a / float(np.median(r)) for a, r in zip(first, found, strict=True)]
        p99 = [float(np.percentile(r, 99)) for r in found]
        rows.append(
            {
                "name": name,
                "calls": sum(map(len, found)),
                "p50_us": float(np.median(np.concatenate(found))),
                "p99_us": float(np.median(p99)),
                "p99_rounds_us": [min(p99), max(p99)],
                "ratio": float(np.median(ratios)),
                "ratio_rounds": [min(ratios), max(ratios)],
            }
        )
    return rows
