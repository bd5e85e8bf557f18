"""How gently the tip touches: force over time, and the worst of many flights."""

from __future__ import annotations

from itertools import groupby
from typing import Any, Final

import numpy as np

from contact_sim.figures.bench import FigureBench
from contact_sim.figures.contact_map import touches
from contact_sim.figures.run import Run
from contact_sim.figures.style import BLUE, ORANGE, RUNS, finish, legend, new_figure
from drone_client.cbf import FilterSettings
from drone_client.mission.arm import Arm
from rgbd_wire.geometry import Array

BEFORE_S: Final = 0.3
OFF_S: Final = 0.05


def draw(bench: FigureBench) -> tuple[Any, str]:
    """Force and compression of both runs; peaks and closing speeds of many."""
    figure = new_figure(5.6)
    panels = figure.subplots(2, 2)
    force, arm = panels[0]
    for run, color in zip(bench.runs, RUNS, strict=True):
        if run.touch_s is None:
            continue
        t_s = np.array([push.t_s for push in run.pushes]) - run.touch_s
        newtons = np.array([push.force_n for push in run.pushes])
        force.plot(t_s, newtons, color=color, lw=0.5, alpha=0.3)
        force.plot(t_s, smooth(newtons), color=color, lw=1.3)
        arm.plot(
            t_s, [1e3 * push.arm_m for push in run.pushes], color=color, lw=1.2, label=run.label
        )
    for axes in (force, arm):
        axes.set_xlim(-BEFORE_S, 3.2)
        axes.axhline(0.0, color="black", lw=0.8)
    finish(force, "force of the tip on the board", "time after the touch [s]", "force [N]")
    finish(arm, "how far the arm is pressed in", "time after the touch [s]", "compression [mm]")
    legend(arm, loc="upper right")
    _of_many(panels[1], bench)
    return figure, _caption(bench)


def smooth(force_n: Array) -> Array:
    """The mean over 20 ms, five turns."""
    return np.convolve(force_n, np.full(5, 0.2), mode="same")


def breaks(run: Run) -> list[tuple[float, float]]:
    """From when to when the tip was off the board between the touch and the retreat [s].

    Counted from the touch; what is not longer than ``OFF_S`` does not count.
    """
    if run.touch_s is None:
        return []
    pushes = [p for p in run.pushes if run.touch_s <= p.t_s < run.contact_end_s]
    found = []
    for is_off, group in groupby(pushes, key=lambda p: p.force_n == 0.0):
        of_group = list(group)
        if is_off and of_group[-1].t_s - of_group[0].t_s > OFF_S:
            found.append((of_group[0].t_s - run.touch_s, of_group[-1].t_s - run.touch_s))
    return found


def _of_breaks(run: Run) -> str:
    """Whether and when the tip came off again."""
    if run.touch_s is None:
        return f"{run.label} does not touch"
    end = _end(run)
    off = breaks(run)
    if not off:
        return f"{run.label} never until {end}"
    last = [push for push in run.pushes if push.t_s < run.contact_end_s][-1]
    comes_back = off[-1][1] < last.t_s - run.touch_s
    times = [f"from {a:.1f} to {b:.1f} s" for a, b in off]
    if comes_back:
        return f"{run.label} {' and '.join(times)}, and then no more until {end}"
    times[-1] = f"from {off[-1][0]:.1f} s to {end}"
    return f"{run.label} {' and '.join(times)}"


def _end(run: Run) -> str:
    """What ended the contact."""
    phase = next((phase for t_s, phase in run.phases if t_s == run.contact_end_s), None)
    return "the end of the flight" if phase is None else f"the {phase.value}"


def _of_many(panels: Any, bench: FigureBench) -> None:
    peaks, speeds = panels
    limit = FilterSettings().touch_mps
    worlds = sorted({row.world for row in bench.many}, reverse=True)
    of_peaks = [[r.peak_force_n for r in bench.many if r.world == w and r.touched] for w in worlds]
    of_speeds = [
        [r.closing_mps for r in bench.many if r.world == w and r.closing_mps is not None]
        for w in worlds
    ]
    top = max((max(v) for v in of_peaks if v), default=1.0)
    edges = [0.0, limit, *(speed for of_world in of_speeds for speed in of_world)]
    look = {"color": [BLUE, ORANGE][: len(worlds)], "histtype": "bar"}
    peaks.hist(of_peaks, bins=np.linspace(0.0, 1.15 * top, 24), label=worlds, **look)
    speeds.hist(of_speeds, bins=np.linspace(min(edges), 1.1 * max(edges), 24), **look)
    speeds.axvline(limit, color="black", ls="--", lw=1.0, label=f"limit, {limit:g} m/s")
    finish(peaks, "peak of each flight", "force [N]", "flights")
    finish(speeds, "how fast the tip met the board", "closing speed [m/s]", "flights")
    legend(peaks)
    legend(speeds, loc="upper right", bbox_to_anchor=(0.86, 1.0))


def _caption(bench: FigureBench) -> str:
    presses = " and ".join(
        "nothing" if (n := run.flown.outcome.press_force_n) is None else f"{n:.2f} N"
        for run in bench.runs
    )
    words = (
        "Force of the tip in both runs (thin: single steps; thick: means of 20 ms). They press "
        f"with {presses} (median) through a spring of {Arm().stiffness_npm:g} N/m, flown "
        f"{bench.eyes_words}. Off the board for more than {1e3 * OFF_S:.0f} ms after the touch: "
        f"{'; '.join(map(_of_breaks, bench.runs))}. Below: {len(touches(bench.many))} flights "
        f"that touched, {bench.many_eyes_words}."
    )
    peaks = [row.peak_force_n for row in bench.many if row.touched]
    speeds = [row.closing_mps for row in bench.many if row.closing_mps is not None]
    if not peaks or not speeds:
        return words
    return (
        f"{words} Peak force {np.median(peaks):.1f} N (median), {max(peaks):.1f} N (worst); "
        f"closing speed {np.median(speeds):.3f} and {max(speeds):.3f} m/s."
    )
