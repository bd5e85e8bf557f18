"""The paper's barrier with its printed gradient, with its true one, and the smooth funnel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from contact_sim.figures.bench import MODEL_WORDS, FigureBench
from contact_sim.figures.run import Run, fly
from contact_sim.figures.style import BLUE, GRAY, ORANGE, finish, legend, new_figure
from contact_sim.lockstep.flight import LockstepSettings
from contact_sim.scene import build_scene
from drone_client.cbf import Barrier, FilterSettings, Variant
from drone_client.mission import Phase, Reason
from rgbd_wire.geometry import Array

NAMES: Final = {
    Variant.PAPER: "as printed",
    Variant.CUSP: "its true gradient",
    Variant.SMOOTH: "smooth funnel with a mouth",
}
COLORS: Final = {Variant.PAPER: ORANGE, Variant.CUSP: GRAY, Variant.SMOOTH: BLUE}
STARTS: Final = tuple((world, seed) for seed in (8, 13, 24) for world in ("tunnel", "refinery"))
LONGEST_S: Final = 70.0
"""A flight that is longer is cut off here."""


def draw(bench: FigureBench) -> tuple[Any, str]:
    """The slope across over the offset, and flights of the whole client with each."""
    of_variant = _flights(bench)
    figure = new_figure(6.4)
    grid = figure.add_gridspec(2, 3, height_ratios=(1.0, 1.1))
    slopes = figure.add_subplot(grid[0, :])
    rho = np.geomspace(3e-4, 1.0, 300)
    for variant, name in NAMES.items():
        style = "--" if variant is Variant.PAPER else "-"
        barrier = _settings(variant).barrier
        slopes.loglog(1e3 * rho, slope(barrier, rho), style, color=COLORS[variant], label=name)
    points = np.geomspace(1e-3, 0.8, 14)
    cusp = _settings(Variant.CUSP).barrier
    slopes.loglog(
        1e3 * points, difference(cusp, points), "o", color="black", ms=3.5,
        label="paper's h, by finite differences",
    )  # fmt: skip
    finish(slopes, "how steep h is across", "offset from the axis [mm]", "|dh/dy| [1]")
    slopes.set_ylim(bottom=0.02)  # room for the legend below all lines
    legend(slopes, loc="lower right")
    first = None
    for i, (variant, runs) in enumerate(of_variant.items()):
        axes = figure.add_subplot(grid[1, i], sharey=first)
        first = first or axes
        for run in runs:
            start_s = run.began(Phase.APPROACH) or 0.0
            axes.plot(run.t_s - start_s, 1e2 * run.tip[:, 0], color=COLORS[variant], lw=1.0)
        axes.axhline(0.0, color="black", lw=0.8)
        axes.set_xlim(0.0, 40.0)
        axes.set_ylim(-5.0, 115.0)
        title = (
            f"{NAMES[variant]}:\n{touched(runs)} of {len(runs)} touch, {kept(runs)} keep contact"
        )
        finish(axes, title, "time from the approach on [s]", "")
        axes.set_title(title, fontsize=9, loc="left")
    assert first is not None
    first.set_ylabel("tip before the board [cm]", fontsize=9)
    return figure, _caption(of_variant)


def slope(barrier: Barrier, rho: Array) -> Array:
    """Length of the lateral part of the gradient so far from the axis [m]."""
    return np.array([abs(barrier.gradient((0.5, float(r), 0.0))[1]) for r in rho])


def difference(barrier: Barrier, rho: Array) -> Array:
    """The same by central differences of h itself."""
    step = 1e-4 * rho
    pairs = zip(rho, step, strict=True)
    return np.array(
        [
            abs(barrier.h((0.5, float(r + d), 0.0)) - barrier.h((0.5, float(r - d), 0.0))) / (2 * d)
            for r, d in pairs
        ]
    )


def _settings(variant: Variant) -> FilterSettings:
    return FilterSettings(variant=variant, allow_unsafe_variant=True)


def _flights(bench: FigureBench) -> dict[Variant, list[Run]]:
    starts = STARTS[:1] if bench.quick else STARTS
    usual = LockstepSettings()
    found: dict[Variant, list[Run]] = {variant: [] for variant in NAMES}
    for world, seed in starts:
        scene = build_scene(world, seed)
        for variant, runs in found.items():
            limits = replace(usual.parts.control.filter, variant=variant, allow_unsafe_variant=True)
            control = replace(usual.parts.control, filter=limits)
            settings = replace(
                usual, parts=replace(usual.parts, control=control), longest_s=LONGEST_S
            )
            runs.append(fly(NAMES[variant], scene, seed, settings=settings))
            done = sum(map(len, found.values()))
            bench.tell("flights with each barrier", done, len(NAMES) * len(starts))
    return found


def touched(runs: list[Run]) -> int:
    """How many touched the board."""
    return sum(run.flown.outcome.touched for run in runs)


def kept(runs: list[Run]) -> int:
    """How many touched, and pressed for as long as they should."""
    return sum(
        run.flown.outcome.touched
        and any(change.reason is Reason.DWELT for change in run.flown.transitions)
        for run in runs
    )


def nearest_cm(runs: list[Run]) -> list[float]:
    """How near each flight's tip came to the board."""
    return sorted(100.0 * run.flown.outcome.nearest_m for run in runs)


def missed(runs: list[Run]) -> str:
    """What became of those that did not touch; empty where there is none."""
    short = [run for run in runs if not run.flown.outcome.touched]
    if not short:
        return ""
    near = nearest_cm(short)
    come = "1 comes" if len(short) == 1 else f"{len(short)} come"
    between = f"{near[0]:.0f} to {near[-1]:.0f}" if len(short) > 1 else f"{near[0]:.0f}"
    phases = [run.flown.phase for run in short]
    given_up, believed = phases.count(Phase.ABORT), phases.count(Phase.DONE)
    parts = []
    if given_up:
        parts.append(f"the mission gives up {given_up}")
    if believed:
        parts.append(f"{believed} went back as if from contact")
    if still := len(short) - given_up - believed:
        are = "is" if still == 1 else "are"
        parts.append(f"{still} {are} still at it after {LONGEST_S:g} s, where they are cut off")
    return f": {come} no nearer than {between} cm; {', and '.join(parts)}"


def _caption(of_variant: dict[Variant, list[Run]]) -> str:
    flights = len(of_variant[Variant.PAPER])
    printed, cusp = (_settings(v).barrier for v in (Variant.PAPER, Variant.CUSP))
    share = slope(printed, np.array([0.01]))[0] / slope(cusp, np.array([0.01]))[0]
    return (
        "Above: the lateral slope of the paper's h is "
        f"steeper than the gradient that it prints; 1 cm beside the axis the printed one shows "
        f"{100 * share:.0f} % of it. Below: the same {flights} starts, flown by the whole client "
        f"with each barrier. As printed {touched(of_variant[Variant.PAPER])} of {flights} touch"
        f"{missed(of_variant[Variant.PAPER])}. "
        f"With the true gradient of the cusp {touched(of_variant[Variant.CUSP])} touch and "
        f"{kept(of_variant[Variant.CUSP])} keep contact for as long as they should; with the "
        f"smooth funnel {touched(of_variant[Variant.SMOOTH])} and "
        f"{kept(of_variant[Variant.SMOOTH])}. Flown {MODEL_WORDS}."
    )
