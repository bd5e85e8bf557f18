"""The barrier h over time, in both runs."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from contact_sim.figures.bench import FigureBench
from contact_sim.figures.run import Run
from contact_sim.figures.style import RUNS, finish, legend, mark_phases, new_figure
from drone_client.cbf import FilterSettings
from drone_client.mission import Phase, Reason

AROUND_S: Final = (-5.0, 4.0)
"""Before and after the touch."""


def draw(bench: FigureBench) -> tuple[Any, str]:
    """The whole flights, and what is close to zero around the touch."""
    figure = new_figure(7.2)
    panels = figure.subplots(3, 1, height_ratios=(1.0, 1.0, 1.1))
    for axes, run, color in zip(panels, bench.runs, RUNS, strict=False):
        axes.plot(run.t_s, run.h, color=color, lw=1.6, label="h at the true tip")
        axes.plot(
            run.tick_t_s, run.h_certain, color=color, lw=1.0, ls="--", label="h that is certain"
        )
        axes.axhline(0.0, color="black", lw=0.8)
        axes.set_xlim(0.0, run.t_s[-1])
        finish(axes, f"{run.label}: safe above 0", "time [s]", "h [m]")
        mark_phases(axes, run.phases, wide=True)
        legend(axes, loc="lower right")
    _around_the_touch(panels[2], bench.runs)
    return figure, _caption(bench)


def _around_the_touch(axes: Any, runs: tuple[Run, Run]) -> None:
    for run, color in zip(runs, RUNS, strict=True):
        if run.touch_s is None:
            continue
        axes.plot(run.t_s - run.touch_s, 1e3 * run.h, color=color, lw=1.6, label=run.label)
        axes.plot(run.tick_t_s - run.touch_s, 1e3 * run.h_certain, color=color, lw=1.0, ls="--")
    axes.axhline(0.0, color="black", lw=0.8)
    axes.axvline(0.0, color="black", lw=0.8, ls=":")
    axes.set_xlim(*AROUND_S)
    axes.set_ylim(-150.0, 340.0)
    finish(axes, "around the touch", "time after the touch [s]", "h [mm]")
    legend(axes, loc="lower left")


def entered_s(run: Run) -> float | None:
    """When the tip came into the safe set to stay there until the touch; None: it did not."""
    before = run.t_s <= (run.touch_s or run.t_s[-1])
    outside = np.nonzero(run.h[before] < 0.0)[0]
    if not len(outside):
        return float(run.t_s[0])
    after = outside[-1] + 1
    return float(run.t_s[after]) if after < before.sum() else None


def least(run: Run) -> tuple[float, float] | None:
    """The least h of the true tip from the first approach on [m], and when [s]; None: none."""
    start_s = run.began(Phase.APPROACH)
    if start_s is None:
        return None
    later = np.nonzero(run.t_s >= start_s)[0]
    i = later[np.argmin(run.h[later])]
    return float(run.h[i]), float(run.t_s[i])


def least_certain(run: Run) -> tuple[float | None, float | None]:
    """The least h that was certain [m], from the approach to the touch and after it; None: none."""
    start_s, touch_s = run.began(Phase.APPROACH), run.contact_end_s
    if start_s is None:
        return None, None
    before = (run.tick_t_s >= start_s) & (run.tick_t_s < touch_s)
    found = []
    for some in (before, run.tick_t_s >= touch_s):
        h = run.h_certain[some]
        h = h[np.isfinite(h)]
        found.append(float(h.min()) if len(h) else None)
    return found[0], found[1]


def ball_mm(run: Run) -> list[float]:
    """Radius of the error ball from the approach on, wherever h was not certainly above zero."""
    start_s = run.began(Phase.APPROACH)
    safe = [
        tick.decision.safe
        for tick in run.flown.ticks
        if start_s is not None and tick.t_ns / 1e9 >= start_s
    ]
    return [1e3 * s.delta_m for s in safe if s is not None and s.h_robust < 0.0]


def _of_certain(runs: tuple[Run, Run]) -> str:
    """Where it was not certain to be inside, and what comes of that; empty where it was."""
    words = []
    for run in runs:
        contact = run.began(Phase.CONTACT) is not None
        parts = [
            f"{1e3 * h:.0f} mm {when if contact else 'without contact'}"
            for h, when in zip(
                least_certain(run), ("before contact ends", "after contact"), strict=True
            )
            if h is not None and round(1e3 * h) < 0
        ]
        if parts:
            words.append(f"to {' and '.join(parts)} in {run.label}")
    if not words:
        return ""
    balls = [mm for run in runs for mm in ball_mm(run)]
    mouth_mm = 1e3 * runs[0].funnel.r_c_m
    return (
        f" It falls below zero, {'; '.join(words)}: in the mouth, {mouth_mm:.0f} mm to each side, "
        f"the ball, there of {min(balls):.1f} to {max(balls):.1f} mm, leaves the tip "
        f"{max(mouth_mm - max(balls), 0.0):.0f} mm (docs/cbf.md, section 3), and it swings by "
        "more. That is allowed, for the ball is how far off the tip could be and not how far it "
        "is: below zero the filter lets h only grow, takes speed off the way in, all of it at "
        f"{1e3 * FilterSettings().outside_m:.0f} mm below, and wants to back off from there on "
        "(section 7), which is what a retreat does. What counts is the true h."
    )


def _of(run: Run) -> str:
    """What happened in one run."""
    entered, low = entered_s(run), least(run)
    side = "outside" if run.h[0] < 0.0 else "inside"
    words = f"{run.label} starts {side}, at h = {run.h[0]:.2f} m"
    if entered is None:
        words += ", and does not stay in the safe set"
    elif entered > run.t_s[0]:
        end = "the end" if run.touch_s is None else "the touch"
        words += f", and stays inside from {entered:.1f} s to {end}"
    words += _stops(run)
    if low is None:
        return words
    h_m, at_s = low
    phase = [phase for t_s, phase in run.phases if t_s <= at_s][-1]
    return f"{words}; from its approach on h is at least {1e3 * h_m:.0f} mm (in {phase.value})"


def _stops(run: Run) -> str:
    """How often it stood still for want of an answer, and which attempt touched."""
    stops = sum(t.reason is Reason.TARGET_OLD for t in run.flown.transitions)
    if not stops:
        return ""
    often = "once" if stops == 1 else f"{stops} times"
    words = f", stops {often} as the newest answer is too old"
    if run.flown.attempts == 1:
        return words
    n = run.touch_attempt
    return f"{words} and touches at {'no attempt' if n is None else f'attempt {n}'}"


def _caption(bench: FigureBench) -> str:
    first, second = (_of(run) for run in bench.runs)
    return (
        f"The barrier at the true tip over time: {first}; {second}. Dashed: what the filter was "
        f"certain of, with the error ball taken off.{_of_certain(bench.runs)} The dips as an "
        "approach and a retreat begin are the vehicle's: it pitches to gain speed, and the tip, "
        f"55 cm ahead, swings up or down. Flown {bench.eyes_words}."
    )
