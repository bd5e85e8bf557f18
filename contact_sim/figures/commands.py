"""Commanded velocities of both runs, and what the vehicle made of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from contact_sim.figures.bench import FigureBench
from contact_sim.figures.run import Run
from contact_sim.figures.style import (
    AXES,
    GRAY,
    PURPLE,
    finish,
    legend,
    mark_phases,
    new_figure,
)
from drone_client.cbf import FilterSettings

LEVEL = (("v_x", 0), ("v_y", 1), ("v_z", 2))


def draw(bench: FigureBench) -> tuple[Any, str]:
    """Velocity along each axis of the target and yaw rate; a column for each run."""
    figure = new_figure(7.2)
    panels = figure.subplots(3, 2, sharex="col", sharey="row")
    for column, run in enumerate(bench.runs):
        along, across, turn = panels[:, column]
        for name, i in LEVEL:
            axes = along if i == 0 else across
            axes.plot(run.t_s, run.velocity_target[:, i], color=AXES[i], lw=0.8, alpha=0.45)
            axes.plot(
                run.tick_t_s, run.command_target[:, i], color=AXES[i], lw=1.4, label=f"${name}$"
            )
        turn.plot(run.tick_t_s, run.yaw_rate_radps, color=PURPLE, lw=1.4)
        along.set_xlim(0.0, run.t_s[-1])
        finish(along, run.label, "", "along the axis [m/s]")
        finish(across, "", "", "across [m/s]")
        finish(turn, "", "time [s]", "yaw rate [rad/s]")
        for axes in (along, across, turn):
            axes.axhline(0.0, color="black", lw=0.8)
            mark_phases(axes, run.phases, named=axes is along)
    panels[0, 0].plot([], [], color=GRAY, lw=0.8, alpha=0.6, label="as flown")
    legend(panels[0, 0], loc="lower right")
    legend(panels[1, 0], loc="lower right")
    for axes in panels[:, 1]:
        axes.set_ylabel("")
    return figure, _caption(bench)


def speed_mps(run: Run) -> float:
    """The fastest command."""
    return float(np.linalg.norm(run.command_target, axis=1).max())


def _closing(run: Run) -> str:
    speed_mps = run.flown.outcome.closing_mps
    return "nothing: it never did" if speed_mps is None else f"{speed_mps:.3f} m/s"


def _caption(bench: FigureBench) -> str:
    limits = FilterSettings()
    first, second = bench.runs
    closing = " and ".join(_closing(run) for run in bench.runs)
    return (
        "Commanded velocity of the body in the frame of the target, negative x towards the board, "
        "and yaw rate; thin lines are what the vehicle flew. The fastest commands are "
        f"{speed_mps(first):.2f} and {speed_mps(second):.2f} m/s (limit {limits.v_max_mps:g}); the "
        f"tips met the board with {closing} (limit {limits.touch_mps:g}). "
        f"Flown {bench.eyes_words}."
    )
