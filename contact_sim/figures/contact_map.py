"""Where the tip touched in many flights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from contact_sim.campaign.row import FlightRow
from contact_sim.figures.bench import FigureBench
from contact_sim.figures.style import BLUE, GRAY, ORANGE, finish, new_figure
from drone_client.cbf import Funnel
from rgbd_wire.geometry import Array
from target_pose.target import Shade, load_round_target

VIEW_M: Final = 0.036
"""To each side, or farther, as far as the touches reach."""
GOAL_M: Final = 0.02
_SHADES: Final = {Shade.BLACK: "#c4c4c4", Shade.WHITE: "white"}
"""Pale, so that points are seen on both."""


def draw(bench: FigureBench) -> tuple[Any, str]:
    """The middle of the print to scale, one panel for each world."""
    rows = bench.many
    worlds = sorted({row.world for row in rows}, reverse=True)
    figure = new_figure(4.7)
    panels = np.atleast_1d(figure.subplots(1, len(worlds), sharey=True))
    view_mm = 1e3 * max(VIEW_M, 1.1 * float(np.abs(touches(rows)).max(initial=0.0)))
    for axes, world, color in zip(panels, worlds, (BLUE, ORANGE), strict=False):
        mine = [row for row in rows if row.world == world]
        _board(axes)
        places = touches(mine)
        axes.plot(
            1e3 * places[:, 0],
            1e3 * places[:, 1],
            "o",
            color=color,
            ms=4,
            alpha=0.7,
            mew=0,
            label="first touch",
        )
        axes.set_xlim(-view_mm, view_mm)
        axes.set_ylim(-view_mm, view_mm)
        axes.set_aspect("equal")
        title = f"{world}: {len(places)} of {len(mine)} touch"
        finish(axes, title, "right of the centre [mm]", "")
    panels[0].set_ylabel("above the centre [mm]", fontsize=9)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=3, fontsize=8)
    return figure, f"{_caption(rows, worlds)} Flown {bench.many_eyes_words}."


def touches(rows: Sequence[FlightRow]) -> Array:
    """(n, 2) beside the centre and above it [m], of those that touched.

    The row's left is that of one who looks along x, out of the board; seen from before it, right.
    """
    places = [
        (row.touch_left_m, row.touch_up_m)
        for row in rows
        if row.touch_left_m is not None and row.touch_up_m is not None
    ]
    return np.array(places, dtype=np.float64).reshape(-1, 2)


def _board(axes: Any) -> None:
    from matplotlib.patches import Circle

    target = load_round_target()
    axes.set_facecolor(_SHADES[target.board_shade])
    for disc in sorted(target.discs, key=lambda d: -d.diameter_m):
        radius_mm = 500.0 * disc.diameter_m
        axes.add_patch(Circle((0, 0), radius_mm, facecolor=_SHADES[disc.shade], lw=0, zorder=0.5))
    for radius_m, style, name in (
        (Funnel().r_c_m, "-", f"the funnel's mouth, {1e3 * Funnel().r_c_m:.0f} mm"),
        (GOAL_M, "--", f"goal, {1e3 * GOAL_M:.0f} mm"),
    ):
        ring = Circle((0, 0), 1e3 * radius_m, fill=False, ls=style, color=GRAY, lw=1.2, label=name)
        axes.add_patch(ring)


def _caption(rows: Sequence[FlightRow], worlds: Sequence[str]) -> str:
    words = []
    for world in worlds:
        mine = [row for row in rows if row.world == world]
        off_mm = 1e3 * np.hypot(*touches(mine).T)
        if not len(off_mm):
            words.append(f"in the {world} none of {len(mine)} touched")
            continue
        within = int((off_mm <= 1e3 * GOAL_M).sum())
        p50, p95 = np.quantile(off_mm, (0.5, 0.95))
        words.append(
            f"in the {world} {within} of {len(mine)} touched within 2 cm (median {p50:.1f} mm, 95 "
            f"% {p95:.1f} mm, worst {off_mm.max():.1f} mm)"
        )
    collided = sum(bool(row.collisions) for row in rows)
    outside = sum(row.outside_m > 0.0 for row in rows)
    each = len({(row.world, row.seed) for row in rows}) == len(rows)
    return (
        f"Where the tip first touched{', one flight a seed' if each else ''}: {'; '.join(words)}. "
        f"Of all flights {outside} pushed outside the mouth, {collided} collided. Over the "
        "middle of the print, to scale, as the drone sees it."
    )
