"""The boundary of the safe set, with the two runs that go through it."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from contact_sim.figures.bench import FigureBench
from contact_sim.figures.run import Run
from contact_sim.figures.style import GRAY, PURPLE, RUNS, finish, legend, new_figure
from drone_client.cbf import CuspFunnel, Funnel
from rgbd_wire.geometry import Array

REACH_M: Final = 1.3
"""From the axis: as far as the boundary is drawn."""
MOUTH_VIEW_M: Final = (0.04, 0.16)
"""Across and along, of the view of the mouth."""


def draw(bench: FigureBench) -> tuple[Any, str]:
    """In space, in the plane of distance and offset, and close to the mouth."""
    funnel = bench.run_1.funnel
    figure = new_figure(7.4)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.35, 1.0))
    space = figure.add_subplot(grid[0, :], projection="3d")
    _in_space(space, bench.runs, funnel)
    plane, mouth = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    rho = np.linspace(0.0, REACH_M, 400)
    plane.fill_between(rho, edge_m(funnel, rho), 3.0, color=PURPLE, alpha=0.15, lw=0)
    plane.plot(rho, edge_m(funnel, rho), color=PURPLE, lw=1.5, label="h = 0")
    for run, color in zip(bench.runs, RUNS, strict=True):
        tip = way_in(run)
        plane.plot(np.hypot(tip[:, 1], tip[:, 2]), tip[:, 0], color=color, lw=1.6, label=run.label)
        plane.plot(*_start(tip), "o", color=color, ms=5)
    plane.set_xlim(0.0, REACH_M)
    plane.set_ylim(-0.05, 2.8)
    finish(plane, "the same, over the offset", "offset from the axis [m]", "x [m]")
    legend(plane, loc="lower right")
    _near_the_mouth(mouth, bench.runs, funnel)
    first, second = (_of(run) for run in bench.runs)
    caption = (
        f"The boundary h = 0 of the safe set (a = {funnel.a:g}) and the way of the tip from the "
        f"start until it goes back from contact: {first}; {second}. The "
        "kink at 1 m is the vehicle that pitches to gain speed: the tip is 55 cm ahead of it. "
        f"{_again(bench.runs)}Flown {bench.eyes_words}."
    )
    return figure, caption


def _of(run: Run) -> str:
    """Where one run starts, and where it touches."""
    side = "outside" if run.h[0] < 0.0 else "inside"
    words = f"{run.label}, seed {run.seed}, starts {side}, at h = {run.h[0]:.2f} m, and"
    off_m = run.flown.outcome.offset_m
    if off_m is None:
        return f"{words} does not touch the board"
    where = "in" if off_m <= run.funnel.r_c_m else "beside"
    return f"{words} touches {1e3 * off_m:.1f} mm from the axis, {where} the mouth"


def _again(runs: tuple[Run, Run]) -> str:
    """Which of them goes to the board more than once: its way is there twice, too."""
    words = [
        f"{run.label.capitalize()} makes {run.flown.attempts} attempts, and touches at "
        f"{'none' if (n := run.touch_attempt) is None else f'attempt {n}'}. "
        for run in runs
        if run.flown.attempts > 1
    ]
    return "".join(words)


def edge_m(funnel: Funnel, rho: Array) -> Array:
    """Where ``h`` is zero so far from the axis [m]: along x it is linear with slope one."""
    return np.array([-funnel.h((0.0, float(r), 0.0)) for r in rho])


def way_in(run: Run) -> Array:
    """The tip (n, 3) from the start until it goes back from contact."""
    return run.tip[run.t_s <= run.contact_end_s]


def _start(tip: Array) -> tuple[list[float], list[float]]:
    return [float(np.hypot(tip[0, 1], tip[0, 2]))], [float(tip[0, 0])]


def _in_space(axes: Any, runs: tuple[Run, Run], funnel: Funnel) -> None:
    rho = np.linspace(0.0, 1.0, 26)
    turn = np.linspace(0.0, 2.0 * np.pi, 41)
    y, z = rho[:, None] * np.cos(turn), rho[:, None] * np.sin(turn)
    x = np.broadcast_to(edge_m(funnel, rho)[:, None], y.shape)
    axes.plot_wireframe(x, y, z, color=PURPLE, lw=0.5, alpha=0.55, rstride=2, cstride=2)
    axes.plot([], [], color=PURPLE, lw=1.0, label="h = 0")
    for run, color in zip(runs, RUNS, strict=True):
        tip = way_in(run)
        axes.plot(*tip.T, color=color, lw=2.2, label=run.label)
        axes.plot(*tip[:1].T, "o", color=color, ms=6)
    axes.set_xlim(0.0, 2.7)
    axes.set_ylim(-1.05, 1.25)
    axes.set_zlim(-1.0, 1.0)
    axes.set_box_aspect((2.7, 2.3, 2.0), zoom=1.1)
    axes.view_init(elev=24, azim=-62)
    axes.set_xlabel("x, out of the board [m]", fontsize=9)
    axes.set_ylabel("y [m]", fontsize=9)
    axes.set_zlabel("z [m]", fontsize=9)
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize=8)
    axes.set_title("the tip in the frame of the target", fontsize=10, loc="left")
    legend(axes, loc="upper left", bbox_to_anchor=(-0.3, 1.0))


def _near_the_mouth(axes: Any, runs: tuple[Run, Run], funnel: Funnel) -> None:
    across, along = MOUTH_VIEW_M
    y = np.linspace(-across, across, 401)
    edge = edge_m(funnel, np.abs(y))
    cusp = CuspFunnel(funnel.a)
    axes.fill_between(1e3 * y, 1e3 * edge, 1e3 * along, color=PURPLE, alpha=0.15, lw=0)
    axes.plot(1e3 * y, 1e3 * edge, color=PURPLE, lw=1.5)
    printed = [-cusp.h((0.0, float(abs(v)), 0.0)) for v in y]
    axes.plot(1e3 * y, 1e3 * np.array(printed), color=GRAY, ls="--", lw=1.2, label="paper's h = 0")
    for run, color in zip(runs, RUNS, strict=True):
        tip = way_in(run)
        axes.plot(1e3 * tip[:, 1], 1e3 * tip[:, 0], color=color, lw=1.2)
    axes.axhline(0.0, color="black", lw=0.8)
    axes.set_xlim(-1e3 * across, 1e3 * across)
    axes.set_ylim(-12.0, 1e3 * along)
    mouth_mm = 1e3 * funnel.r_c_m
    finish(axes, f"the mouth, {mouth_mm:.0f} mm to each side", "y [mm]", "x [mm]")
    legend(axes, loc="upper right")
