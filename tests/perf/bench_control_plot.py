"""The paper's barrier as it is printed, its true gradient, and the smooth funnel, flown alike."""

from __future__ import annotations

import os
import random
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from drone_client.cbf import FilterSettings, Variant
from drone_client.guidance import GuidanceSettings
from tests.perf.bench_control_flight import Flight, Start, World, fly
from tests.perf.bench_control_trials import inside

SECONDS = 40.0
WORLD = World(noise_m=0.0005, noise_per_m=0.001, noise_rad=0.004, seconds=SECONDS, quick_eyes=True)
NAMES = {
    Variant.PAPER: "as printed",
    Variant.CUSP: "its true gradient",
    Variant.SMOOTH: "smooth funnel with a mouth",
}


def flights(starts: int) -> dict[Variant, list[Flight]]:
    """The same starts with each barrier."""
    found: dict[Variant, list[Flight]] = {}
    for variant in NAMES:
        limits = FilterSettings(variant=variant, allow_unsafe_variant=True)
        for seed in range(starts):
            rng = random.Random(seed)
            tip = inside(rng)
            # Further out than most: how it comes in is what is to be seen.
            start = Start((tip[0] + 0.6, tip[1], tip[2]), rng.uniform(-0.4, 0.4), seed)
            flight = fly(start, WORLD, limits, GuidanceSettings(), keep_ticks=True)
            found.setdefault(variant, []).append(flight)
    return found


def outcome(of_variant: dict[Variant, list[Flight]]) -> list[dict[str, Any]]:
    """Touches, where the tip ended, and how often a command turned against the one before."""
    rows = []
    for variant, found in of_variant.items():
        ends = [flight.ticks[-1].tip[0] for flight in found]
        turns = [reversals(flight) for flight in found]
        rows.append(
            {
                "name": NAMES[variant],
                "flights": len(found),
                "touched": sum(flight.touch is not None for flight in found),
                "end_m": [min(ends), max(ends)],
                "reversals": [min(turns), max(turns)],
            }
        )
    return rows


def reversals(flight: Flight) -> int:
    """How often a commanded tip velocity points against the one before."""
    commands = [tick.tip_command for tick in flight.ticks]
    pairs = zip(commands, commands[1:], strict=False)
    return sum(sum(a * b for a, b in zip(one, two, strict=True)) < 0.0 for one, two in pairs)


def draw(of_variant: dict[Variant, list[Flight]], path: Path) -> None:
    """Distance of the tip over time, one panel a barrier."""
    figure, panels = plt.subplots(1, len(of_variant), figsize=(11, 3.4), sharey=True)
    for panel, (variant, found) in zip(panels, of_variant.items(), strict=True):
        for flight in found:
            seconds = [tick.t_s for tick in flight.ticks]
            panel.plot(seconds, [100 * tick.tip[0] for tick in flight.ticks], lw=1)
        touched = sum(flight.touch is not None for flight in found)
        panel.set_title(f"{NAMES[variant]}: {touched} of {len(found)} touch", fontsize=10)
        panel.axhline(0.0, color="black", lw=0.8)
        panel.set_xlabel("time [s]")
        panel.set_xlim(0, SECONDS)
        panel.set_ylim(-4, 40)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("tip before the board [cm]")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    figure.savefig(part, dpi=110, format="png")
    plt.close(figure)
    os.replace(part, path)
