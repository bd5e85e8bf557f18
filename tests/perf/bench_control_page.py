"""What very many flights amount to, the figures to reach, and the page that says so."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.perf.bench_control_trials import TRIALS

Rows = Sequence[dict[str, Any]]
Goal = tuple[str, str, str, bool]
"""What, goal, measured, met."""
CLOSING_MPS, NEAR_M, NEAR_SHARE = 0.05, 0.02, 0.95
COASTING_M = 0.005
"""A vehicle with a lag that is told to stop still rolls on; more than this is no retreat."""
WHAT = {
    "invariance": "start values, mouth of 25 mm",
    "invariance, mouth 30 mm": "mouth of 30 mm",
    "invariance, whole target filter": "start values, the whole target filter",
    "invariance, mouth 30 mm, whole target filter": "mouth of 30 mm, the whole target filter",
    "hasty guidance": "mouth of 30 mm, guidance as hasty as its bounds let it",
    "outside": "starts outside the funnel, propellers kept out of the wall",
    "link lost": "link lost at a random moment",
    "tunnel": "in a tunnel of 1.7 m x 0.6 m, link lost at a random moment",
    "contact": "noise as the localiser's, the whole target filter",
}


def summarise(by_trial: dict[str, list[dict[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Figures of each trial."""
    return {name: _summary(rows) for name, rows in by_trial.items()}


def _summary(rows: Rows) -> dict[str, Any]:
    touched = [row for row in rows if row["touched"]]
    summary: dict[str, Any] = {
        "flights": len(rows),
        "touched": len(touched),
        "outside": [row["seed"] for row in touched if row["outside_m"] > 0.0],
        "near": sum(row["beside_m"] <= NEAR_M for row in touched),
    }
    if touched:
        summary["closing_mps"] = _spread([row["closing_mps"] for row in touched])
        summary["beside_mm"] = _spread([1e3 * row["beside_m"] for row in touched])
        summary["mouth_left_mm"] = -1e3 * max(row["outside_m"] for row in touched)
    waiting = [row for row in rows if not row["touched"] and "last_m" in row]
    if waiting:
        summary["waits_mm"] = _spread([1e3 * row["last_m"][0] for row in waiting])
        summary["outside_at_last"] = sum(row["h_last"] < 0.0 for row in waiting)
    if "gap_m" in rows[0]:
        summary["gap_mm"] = 1e3 * min(row["gap_m"] for row in rows)
    if "approach_mps" in rows[0]:
        for name in ("approach_mps", "brake_late_ms", "coasting_mps", "lost_m"):
            summary[name] = max(row[name] for row in rows)
        summary["out_m"] = min(row["out_m"] for row in rows)
    return summary


def _spread(values: Sequence[float]) -> list[float]:
    """p50, p95, largest."""
    return [float(v) for v in np.percentile(values, [50, 95, 100])]


def goals(result: dict[str, Any]) -> list[Goal]:
    """The figures to reach, and what was measured."""
    agreed = result["agreement"]["CVXPY, polished"]
    speeds = {row["name"]: row for row in result["speed"]}
    solver = next(row for name, row in speeds.items() if name.startswith("`solve`"))
    whole = next(row for name, row in speeds.items() if name.endswith("the whole tick"))
    states, trials = result["states"], result["trials"]
    invariant = {k: v for k, v in trials.items() if k.startswith(("invariance", "hasty"))}
    flown = sum(t["flights"] for t in invariant.values())
    touches = sum(t["touched"] for t in invariant.values())
    wrong = sum(len(t["outside"]) for t in invariant.values())
    around, lost, contact = trials["outside"], trials["link lost"], trials["contact"]
    near = contact["near"] / contact["flights"]
    closing = contact.get("closing_mps", [float("nan")] * 3)[1]
    printed = result["variants"][0]
    return [
        (
            "same answer as the paper's problem in CVXPY",
            "to 1e-8",
            f"{100 * agreed['within_1e-8']:.1f} % of {agreed['problems']}, at most "
            f"{agreed['max']:.0e}",
            agreed["within_1e-8"] == 1.0,
        ),
        (
            "the same problem, against CVXPY (DPP), medians",
            ">= 500 x faster",
            f"{solver['ratio']:.0f} x ({_range(solver['ratio_rounds'])})",
            solver["ratio"] >= 500,
        ),
        (
            "one constraint, p99",
            "< 20 us",
            f"{solver['p99_us']:.1f} us; the whole tick {whole['p99_us']:.1f} us (rounds "
            f"{_range(whole['p99_rounds_us'], '.1f')}), its median {whole['p50_us']:.1f} us",
            whole["p99_us"] < 20 and solver["p99_us"] < 20,
        ),
        (
            "random states: an answer, finite, within limits, with the right status",
            "every one",
            f"{states['count'] - sum(states['wrong'].values())} of {states['count']}",
            not states["wrong"],
        ),
        (
            "from inside: the wall is met in the mouth or not at all",
            "every approach",
            f"{flown - wrong} of {flown}; {touches} touched",
            not wrong,
        ),
        (
            "from outside, all around: reaches it or retreats, never behind the board",
            "every approach",
            f"{around['flights'] - len(around['outside'])} of {around['flights']}; "
            f"{around['touched']} touched, {around.get('outside_at_last', 0)} were still outside "
            "the funnel at the end",
            not around["outside"],
        ),
        (
            "link lost: brakes after the hold limit",
            "within 100 ms",
            f"{lost['brake_late_ms']:.0f} ms at most, of {lost['flights']} flights",
            lost["brake_late_ms"] <= 100,
        ),
        (
            "link lost: then retreats, never nearer again",
            "every flight",
            f"commanded approach at most {lost['approach_mps']:.3f} m/s, rolled on "
            f"{1e3 * lost['lost_m']:.1f} mm, ended {lost['out_m']:.2f} m out or further",
            lost["approach_mps"] <= 1e-9 and lost["lost_m"] <= COASTING_M and lost["out_m"] > 0.9,
        ),
        (
            "contact within 2 cm of the centre",
            ">= 95 %",
            f"{100 * near:.1f} % of {contact['flights']}",
            near >= NEAR_SHARE,
        ),
        (
            "closing speed of the tip at the touch, p95",
            "<= 0.05 m/s",
            f"{closing:.3f} m/s",
            closing <= CLOSING_MPS,
        ),
        (
            "the paper's gradient as printed",
            "shown to stall",
            f"{printed['touched']} of {printed['flights']} touch; the rest hang "
            f"{_range([100 * v for v in printed['end_m']])} cm before the board",
            not printed["touched"],
        ),
    ]


def page(result: dict[str, Any], command: str, picture: str) -> tuple[str, bool]:
    """The page, and whether every figure that is about safety is met."""
    rows = goals(result)
    safe = all(met for *_, met in rows[3:8])
    machine = f"{os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    lines = [
        "# The safety filter in figures",
        "",
        f"Made by `{command}` on {machine}; sources {result['sources']}"
        + ("." if result["share"] == 1.0 else f"; {100 * result['share']:g} % of a full run."),
        "",
        "## Goals",
        "",
        "| | goal | measured | |",
        "| --- | --- | --- | --- |",
        *(f"| {a} | {b} | {c} | {'met' if met else 'missed'} |" for a, b, c, met in rows),
        "",
        *_flights(result["trials"]),
        *_link(result["trials"]["link lost"]),
        *_variants(result["variants"], picture),
        *_solvers(result),
        *_states(result["states"]),
    ]
    return "\n".join(lines) + "\n", safe


def _flights(trials: dict[str, dict[str, Any]]) -> list[str]:
    loose, fine = TRIALS["invariance"].world, TRIALS["contact"].world
    lines = [
        "## Approaches",
        "",
        "The real guidance, target filter and safety filter at 50 Hz; a drone that follows with a "
        f"lag of {loose.lag_s:g} s; results at {loose.rate_hz:g} Hz, {1e3 * loose.delay_s:.0f} ms "
        f"late; odometry that drifts {100 * loose.drift_mps:g} cm/s. The first five have "
        f"{100 * loose.noise_m:g} cm of noise along each axis, the others "
        f"{1e3 * fine.noise_m:g} mm and {1e3 * fine.noise_per_m:g} mm per square metre of range. "
        "Inside, starts are 0.15 to 2 m from the board. Where it does not say *the "
        "whole target filter*, its arithmetic is done for one axis, which a test holds against "
        "the whole. *Mouth left*: how much nearer to the centre than the mouth's rim the tip was "
        "at worst, behind the board's plane.",
        "",
        "| | flights | touched | outside the mouth | mouth left [mm] | beside the centre [mm], p50 "
        "/ p95 / max | closing [m/s] | those that do not touch wait at [mm] |",
        "| --- | ---: | ---: | ---: | ---: | --- | --- | --- |",
    ]
    for name, t in trials.items():
        if name == "link lost":
            continue
        left = f"{t['mouth_left_mm']:.1f}" if t["touched"] else "-"
        beside, closing, waits = t.get("beside_mm"), t.get("closing_mps"), t.get("waits_mm")
        lines.append(
            f"| {WHAT[name]} | {t['flights']} | {t['touched']} | {len(t['outside'])} | {left} | "
            f"{_three(beside, '.1f')} | {_three(closing, '.3f')} | {_three(waits, '.0f')} |"
        )
    gap, narrow = trials["outside"]["gap_mm"], trials["tunnel"]
    return [
        *lines,
        "",
        "With a noise of 1 cm the error ball is 17 to 18 mm; at the touch the start values' mouth "
        "of 25 mm admits 20 mm, one of 30 mm 24 mm (docs/cbf.md, section 3). Whoever is further "
        "beside the axis than what is left waits before the board, for nobody could promise where "
        "it would touch. "
        f"From outside, no propeller came nearer to the wall than {gap:.0f} mm. In the tunnel, "
        f"none came nearer to any side than {narrow['gap_mm']:.0f} mm, of which 100 mm are its "
        "clearance. While it waits there blind, the doubt about both walls grows by 1 cm/s, and "
        f"it moves to the middle: the tip came nearer to the board by {narrow['lost_m']:.2f} m at "
        f"most, at {narrow['approach_mps']:.3f} m/s at most.",
        "",
    ]


def _link(lost: dict[str, Any]) -> list[str]:
    return [
        "## Link lost",
        "",
        f"{lost['flights']} flights, the link silent from a random moment between 0.3 and 12 s "
        "on: on the way in, at the touch, or while it presses. From the age of 300 ms on the "
        f"largest commanded approach was {lost['approach_mps']:.3f} m/s. The last command that was "
        f"anything but standing or straight out ended {lost['brake_late_ms']:.0f} ms after the "
        "hold limit (600 ms). The vehicle itself, which lags, still closed in at up to "
        f"{lost['coasting_mps']:.3f} m/s 100 ms after that limit, and rolled on "
        f"{1e3 * lost['lost_m']:.1f} mm past 1.5 s, when the retreat begins. All ended "
        f"{lost['out_m']:.2f} m or further from the board.",
        "",
    ]


def _variants(rows: list[dict[str, Any]], picture: str) -> list[str]:
    return [
        "## The paper's barrier",
        "",
        f"![Distance of the tip over time, three barriers](figures/{picture})",
        "",
        "The same starts, noise and drone with each barrier, at most 40 s.",
        "",
        "| | flights | touched | ends before the board [cm] | commands turned around |",
        "| --- | ---: | ---: | --- | --- |",
        *(
            f"| {r['name']} | {r['flights']} | {r['touched']} | "
            f"{_range([100 * v for v in r['end_m']], '.1f')} | {_range(r['reversals'])} |"
            for r in rows
        ),
        "",
    ]


def _solvers(result: dict[str, Any]) -> list[str]:
    lines = [
        "## Against solvers",
        "",
        "Wall time per call, in rounds that alternate between the contenders; p99 is the median of "
        "the rounds, the ratio is of medians.",
        "",
        "| | calls | p50 [us] | p99 [us] | p99 of the rounds [us] | faster than CVXPY (DPP) |",
        "| --- | ---: | ---: | ---: | --- | --- |",
    ]
    for r in result["speed"]:
        digits = ".0f" if r["ratio"] >= 10 else ".1f"
        lines.append(
            f"| {r['name']} | {r['calls']} | {r['p50_us']:.1f} | {r['p99_us']:.1f} | "
            f"{_range(r['p99_rounds_us'], '.1f')} | {r['ratio']:{digits}} x "
            f"({_range(r['ratio_rounds'], digits)}) |"
        )
    lines += [
        "",
        "A quadratic program knows no ball: DAQP and OSQP have a box around it, and are compared "
        "where the ball is not what limits. *Polished*: two steps of Newton's on the active "
        "constraints that CVXPY found; an interior point stops where many velocities are nearly "
        "as good.",
        "",
        "| answers apart | problems | within 1e-8 | p50 | max |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for name, a in result["agreement"].items():
        lines.append(
            f"| {name} | {a['problems']} | {100 * a['within_1e-8']:.1f} % | {a['p50']:.0e} | "
            f"{a['max']:.0e} |"
        )
    return [*lines, ""]


def _states(states: dict[str, Any]) -> list[str]:
    kinds = ", ".join(f"{name} {count}" for name, count in states["kinds"].items())
    statuses = ", ".join(f"{name} {count}" for name, count in sorted(states["statuses"].items()))
    wrong = ", ".join(f"{name} {count}" for name, count in states["wrong"].items()) or "none"
    return [
        "## Random states",
        "",
        f"{kinds}. Answers: {statuses}. Wrong: {wrong}.",
        "",
        "*Broken*: one number of the input is NaN, infinite or absurd. *Stale*: older than 300 ms, "
        "or an age that cannot be. *Keep-outs*: with a wall and a floor, four propellers each, and "
        "any age up to 2 s.",
    ]


def _three(values: Sequence[float] | None, digits: str) -> str:
    return "-" if values is None else " / ".join(f"{v:{digits}}" for v in values)


def _range(values: Sequence[float], digits: str = ".0f") -> str:
    return f"{min(values):{digits}} to {max(values):{digits}}"
