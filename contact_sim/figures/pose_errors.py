"""Errors in position and yaw of both runs."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from contact_sim.figures.bench import FigureBench
from contact_sim.figures.run import Run
from contact_sim.figures.style import AXES, PURPLE, finish, legend, mark_phases, new_figure

CLOSE_MM: Final = 40.0


def draw(bench: FigureBench) -> tuple[Any, str]:
    """Place of the tip, the same across in millimetres, and yaw; a column for each run."""
    figure = new_figure(7.2)
    panels = figure.subplots(3, 2, sharex="col", sharey="row")
    for column, run in enumerate(bench.runs):
        place, across, yaw = panels[:, column]
        for i, name in enumerate("xyz"):
            place.plot(run.t_s, run.tip[:, i], color=AXES[i], lw=1.5, label=f"$e_{name}$")
            if i:
                across.plot(
                    run.t_s, 1e3 * run.tip[:, i], color=AXES[i], lw=1.2, label=f"$e_{name}$"
                )
        yaw.plot(run.t_s, np.degrees(run.yaw_error_rad), color=PURPLE, lw=1.5)
        across.set_ylim(-CLOSE_MM, CLOSE_MM)
        place.set_xlim(0.0, run.t_s[-1])
        for axes in (place, across, yaw):
            axes.axhline(0.0, color="black", lw=0.8)
        finish(place, run.label, "", "position error [m]")
        finish(across, "", "", "across, close up [mm]")
        finish(yaw, "", "time [s]", "yaw error [deg]")
        for axes in (place, across, yaw):
            mark_phases(axes, run.phases, named=axes is place)
    legend(panels[0, 0], loc="upper right")
    legend(panels[1, 0], loc="lower right")
    for axes in panels[:, 1]:
        axes.set_ylabel("")
    return figure, _caption(bench)


def settled_s(run: Run) -> tuple[float | None, float | None]:
    """From when on e_y, e_z are within 5 cm as long as contact lasts, and e_x [s]; None: never."""
    end = run.t_s <= run.contact_end_s
    across = np.hypot(run.tip[end, 1], run.tip[end, 2])
    return _last_over(run.t_s[end], across), _last_over(run.t_s[end], np.abs(run.tip[end, 0]))


def _last_over(t_s: np.ndarray[Any, Any], error: np.ndarray[Any, Any]) -> float | None:
    over = np.nonzero(error > 0.05)[0]
    if not len(over):
        return float(t_s[0])
    return None if over[-1] == len(t_s) - 1 else float(t_s[over[-1]])


def _of(run: Run) -> str:
    """In which order the errors of one run went."""
    across, along = settled_s(run)
    if across is None:
        order = "neither lines up nor closes in" if along is None else "does not line up"
    elif along is None:
        order = "lines up and does not close in"
    elif across < along:
        order = "lines up before it closes in"
    else:
        order = "does not line up before it closes in"
    times = " against ".join("never" if s is None else f"{s:.1f} s" for s in (across, along))
    return f"{run.label} {order} ({times})"


def _caption(bench: FigureBench) -> str:
    return (
        "Errors of the true tip's place in the frame of the target, and of the heading. "
        "Lined up is a tip whose e_y and e_z stay within 5 cm to the end of contact, closed in one "
        f"whose e_x does: {'; '.join(map(_of, bench.runs))}. Flown {bench.eyes_words}."
    )
