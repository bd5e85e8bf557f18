"""Random states, most of them bad: does the filter always answer, and with the right status?"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from drone_client.cbf import (
    FilterInput,
    FilterSettings,
    KeepOut,
    PlaneFrame,
    SafeCommand,
    Status,
    build,
    error_ball_m,
    filter_command,
)
from drone_client.cbf.limits import alpha
from drone_client.cbf.vector import Vec3
from tests.perf.bench_control_speed import FACING
from tests.perf.bench_control_trials import PROPELLERS, WALL

MS = 1_000_000
FLYING, GROUNDED = FilterSettings(), FilterSettings(v_max_mps=0.0)
FLOOR = KeepOut("floor", PROPELLERS, (0.0, 0.0, 1.0), -0.8, PlaneFrame.WORLD)
BROKEN = (math.nan, math.inf, -math.inf, 1e300, -1e300, 10**400)
VECTORS = ("tip_target", "velocity_tip_nominal_target", "lever_arm_target", "up_target")
NUMBERS = ("yaw_rate_nominal_radps", "range_m", "sigma_m")
KINDS = ("inside", "outside", "on the axis", "behind", "broken", "stale", "no speed", "keep-outs")


@dataclass
class Answers:
    """Counts of one run."""

    states: Counter[str] = field(default_factory=Counter)
    statuses: Counter[str] = field(default_factory=Counter)
    wrong: Counter[str] = field(default_factory=Counter)
    """By what was wrong; empty if all is well."""


def ask(count: int, seed: int, step: Callable[[int], None]) -> Answers:
    """Ask the filter about so many states."""
    rng, answers = random.Random(seed), Answers()
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        inp, settings = _state(kind, rng)
        answers.states[kind] += 1
        try:
            command = filter_command(inp, settings)
        except Exception as error:  # that there is none is what is measured
            answers.wrong[f"{kind}: {type(error).__name__}"] += 1
            continue
        if command is None:
            answers.wrong[f"{kind}: no command"] += 1
            continue
        answers.statuses[command.status] += 1
        for what in _faults(kind, inp, settings, command):
            answers.wrong[f"{kind}: {what}"] += 1
        if number % 10_000 == 0:
            step(number)
    return answers


def _state(kind: str, rng: random.Random) -> tuple[FilterInput, FilterSettings]:
    scale = rng.choice((1.0, 0.05))
    x = rng.uniform(-0.1, 0.0) if kind == "behind" else rng.uniform(0.0, 3.0) * scale
    tip = (x, rng.gauss(0.0, 0.5) * scale, rng.gauss(0.0, 0.5) * scale)
    if kind == "on the axis":
        tip = (rng.uniform(-0.1, 2.0), 0.0, 0.0)
    if kind == "inside":
        tip = (x, rng.gauss(0.0, 0.1) * x * x, rng.gauss(0.0, 0.1) * x * x)
    wish = rng.choice((0.05, 0.4, 3.0))
    inp = {
        "tip_target": tip,
        "velocity_tip_nominal_target": _gaussian(rng, wish),
        "yaw_rate_nominal_radps": rng.gauss(0.0, 1.0),
        "lever_arm_target": (-0.55, rng.gauss(0.0, 0.1), rng.gauss(0.0, 0.1)),
        "up_target": (0.0, 0.0, 1.0),
        "age_ns": rng.randrange(0, 300 * MS),
        "range_m": rng.uniform(0.3, 4.0),
        "sigma_m": rng.uniform(0.0, 0.01),
    }
    if kind == "stale":
        inp["age_ns"] = rng.choice(
            (rng.randrange(300 * MS + 1, 10_000 * MS), -1, -(10**30), 10**30)
        )
    if kind == "keep-outs":
        inp |= {"keep_outs": (WALL, FLOOR), "target_from_body": FACING}
        inp["age_ns"] = rng.randrange(0, 2_000 * MS)
    if kind == "broken":
        bad = rng.choice(BROKEN)
        name = rng.choice((*VECTORS, *NUMBERS))
        good = inp[name]
        axis = rng.randrange(3)
        inp[name] = (
            tuple(bad if i == axis else c for i, c in enumerate(good)) if name in VECTORS else bad
        )
    return FilterInput(**inp), GROUNDED if kind == "no speed" else FLYING


def _faults(
    kind: str, inp: FilterInput, settings: FilterSettings, command: SafeCommand
) -> list[str]:
    """What is wrong with an answer."""
    faults = []
    velocity, yaw_rate = command.velocity_body_target, command.yaw_rate_radps
    if not all(math.isfinite(c) for c in (*velocity, yaw_rate)):
        return ["not finite"]
    if math.hypot(*velocity) > settings.v_max_mps + 1e-12:
        faults.append("too fast")
    if abs(yaw_rate) > settings.yaw_rate_max_radps:
        faults.append("turns too fast")
    if command.status not in _allowed(kind, inp, settings, command):
        faults.append(f"status {command.status}")
    if kind == "broken" and (velocity != (0.0, 0.0, 0.0) or yaw_rate != 0.0):
        faults.append("moves on what is no number")
    return faults


def _allowed(
    kind: str, inp: FilterInput, settings: FilterSettings, command: SafeCommand
) -> set[Status]:
    """What the status may be, worked out apart from the filter."""
    if kind == "broken":
        return {Status.ABORT}
    x, funnel = inp.tip_target[0], settings.funnel
    if x < -settings.depth_max_m or (x < 0.0 and funnel.h(inp.tip_target) < 0.0):
        return {Status.ABORT}
    if not 0 <= inp.age_ns <= settings.age_max_ns:
        return {Status.STALE}
    if inp.keep_outs:
        return {Status.INACTIVE, Status.ACTIVE, Status.MAX_HDOT}
    delta = error_ball_m(inp.age_ns, inp.range_m, inp.sigma_m, settings)
    later = error_ball_m(
        inp.age_ns + round(settings.period_s * 1e9), inp.range_m, inp.sigma_m, settings
    )
    space = build(
        funnel,
        inp.tip_target,
        delta,
        (later - delta) / settings.period_s,
        alpha(inp.tip_target, settings),
    )
    arm = math.hypot(inp.lever_arm_target[0], inp.lever_arm_target[1])
    left = settings.v_max_mps - abs(command.yaw_rate_radps) * arm
    spare = left - space.offset / math.hypot(*space.normal)
    if abs(spare) < 1e-9:
        return {Status.ACTIVE, Status.INACTIVE, Status.MAX_HDOT}
    return {Status.MAX_HDOT} if spare < 0.0 else {Status.ACTIVE, Status.INACTIVE}


def _gaussian(rng: random.Random, sigma: float) -> Vec3:
    return rng.gauss(0.0, sigma), rng.gauss(0.0, sigma), rng.gauss(0.0, sigma)
