"""How long one tick of the safety filter takes, beside the paper's CVXPY problem, in one run.

    python tests/perf/bench_cbf.py

The rounds alternate between the contenders, so that a slow moment of the machine hits all of them.
Median and p99 are wall time per call; the ratio is of the mean processor time per call, round by
round, so that what else the machine does is not in it, and its spread is printed.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cvxpy as cp
import numpy as np

from drone_client.cbf import FilterInput, FilterSettings, HalfSpace, build, filter_command, solve
from drone_client.cbf.vector import Vec3

SETTINGS = FilterSettings()
V_MAX = SETTINGS.v_max_mps
DELTA_M = 0.012


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


def cvxpy_rebuilt(case: Case) -> None:
    """The paper's problem as it reads, with the speed limit: built and solved every tick."""
    u = cp.Variable(3)
    constraints = [
        np.array(case.half_space.normal) @ u >= case.half_space.offset,
        cp.norm(u) <= V_MAX,
    ]
    cp.Problem(cp.Minimize(cp.norm(u - np.array(case.u_nominal))), constraints).solve()


def cvxpy_parametrised() -> Callable[[Case], None]:
    """The same problem compiled once, its numbers as parameters (CVXPY's DPP)."""
    u, nominal, normal, offset = cp.Variable(3), cp.Parameter(3), cp.Parameter(3), cp.Parameter()
    constraints = [normal @ u >= offset, cp.norm(u) <= V_MAX]
    problem = cp.Problem(cp.Minimize(cp.norm(u - nominal)), constraints)

    def run(case: Case) -> None:
        nominal.value = np.array(case.u_nominal)
        normal.value = np.array(case.half_space.normal)
        offset.value = case.half_space.offset
        problem.solve()

    return run


class Round(NamedTuple):
    """One contender's calls, one after another."""

    wall_us: list[float]
    """Of each call, the reading of the clock (under 0.1 us) included."""
    cpu_us: float
    """Mean of the calls."""


def measure(run: Callable[[Case], object], cases: list[Case]) -> Round:
    """Run every case once."""
    wall_us, cpu_ns = [], time.process_time_ns()
    for case in cases:
        start = time.perf_counter_ns()
        run(case)
        wall_us.append((time.perf_counter_ns() - start) / 1e3)
    return Round(wall_us, (time.process_time_ns() - cpu_ns) / 1e3 / len(cases))


def main() -> None:
    """Print median, p99 and the ratio to the first contender."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=10)
    arguments = parser.parse_args()
    contenders: dict[str, tuple[Callable[[Case], object], int]] = {
        "CVXPY, rebuilt every tick": (cvxpy_rebuilt, 20),
        "CVXPY, parametrised once": (cvxpy_parametrised(), 50),
        "filter_command (everything)": (lambda c: filter_command(c.inp, SETTINGS), 2_000),
        "solve (the same problem)": (lambda c: solve(c.u_nominal, c.half_space, V_MAX), 5_000),
    }
    cases = {name: random_cases(n) for name, (_, n) in contenders.items()}
    for name, (run, _) in contenders.items():
        measure(run, cases[name])  # warm up

    rounds: dict[str, list[Round]] = {name: [] for name in contenders}
    for _ in range(arguments.rounds):
        for name, (run, _) in contenders.items():
            rounds[name].append(measure(run, cases[name]))

    first = [r.cpu_us for r in rounds[next(iter(contenders))]]
    print(f"{'':30} {'median us':>10} {'p99 us':>10}   ratio to the first (min - max of rounds)")
    for name, of_name in rounds.items():
        wall_us = np.concatenate([np.array(r.wall_us) for r in of_name])
        ratios = [a / r.cpu_us for a, r in zip(first, of_name, strict=True)]
        print(
            f"{name:30} {np.median(wall_us):10.2f} {np.percentile(wall_us, 99):10.2f}   "
            f"{statistics.median(ratios):.0f} x ({min(ratios):.0f} - {max(ratios):.0f})"
        )


if __name__ == "__main__":
    main()
