"""d1 + d2 and age of every result against the gate's verdict, on a link that gets slow."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from contact_sim.figures.bench import MODEL_WORDS, FigureBench
from contact_sim.figures.run import Run, fly
from contact_sim.figures.style import (
    AMBER,
    BLUE,
    GRAY,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    finish,
    legend,
    mark_phases,
    new_figure,
)
from contact_sim.lockstep.flight import LockstepFlight, LockstepSettings
from contact_sim.scene import build_scene
from drone_client.cbf import Freshness
from drone_client.gate import Verdict
from drone_client.mission import Phase
from drone_client.reception import Reception

WORLD, SEED = "tunnel", 26
EXTRA_MS: Final = 150.0
"""Most that each direction gets slower by."""
SLOW_FROM_M, SLOW_S = 0.45, 6.0
"""The link is slow for so long, from this distance of the tip on."""
STEP_NS: Final = 100_000_000
_LOOKS: Final = {
    Verdict.ACCEPTED: (BLUE, "o"),
    Verdict.NETWORK_DELAY: (ORANGE, "x"),
    Verdict.TOO_OLD: (PURPLE, "s"),
    Verdict.OUT_OF_ORDER: (GREEN, "^"),
}
_PHASES: Final = {Freshness.HOLD: "#F0E442", Freshness.BRAKE: AMBER, Freshness.RETREAT: ORANGE}

_LEVELS: Final = {
    Freshness.HOLD: "old: holds",
    Freshness.BRAKE: "older: brakes",
    Freshness.RETREAT: "oldest: backs off",
}
"""Of the newest accepted result; not in the words of the mission's phases."""


class SlowLink:
    """Makes the link slower and faster again, as a hump of half a sine, on the way in."""

    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._next_ns = 0

    @property
    def slowed(self) -> bool:
        """The tip came near enough for it to begin."""
        return self._since_ns is not None

    def __call__(self, flight: LockstepFlight) -> None:
        """Before every tick."""
        now_ns, distance_m = flight.simulation.t_ns, flight.tip_distance_m
        if self._since_ns is None:
            near = flight.phase is Phase.APPROACH and distance_m is not None
            if not near or (distance_m or 0.0) > SLOW_FROM_M:
                return
            self._since_ns = self._next_ns = now_ns
        if now_ns < self._next_ns or now_ns > self._since_ns + (SLOW_S + 1.0) * 1e9:
            return
        self._next_ns = now_ns + STEP_NS
        share = min((now_ns - self._since_ns) / (SLOW_S * 1e9), 1.0)
        extra_ms = EXTRA_MS * float(np.sin(np.pi * share))
        flight.link.slow(extra_ms / 1e3)


def draw(bench: FigureBench) -> tuple[Any, str]:
    """Every result in the plane of the two delays, and over time with what the drone did."""
    bench.tell("a flight on a slow link", 0, 1)
    settings = LockstepSettings()
    link = SlowLink()
    run = fly("slow link", build_scene(WORLD, SEED), SEED, before_tick=link)
    gate = settings.parts.gate
    tau_ms, age_ms = gate.tau_max_ns / 1e6, gate.age_max_ns / 1e6
    figure = new_figure(7.6)
    grid = figure.add_gridspec(3, 1, height_ratios=(1.5, 1.0, 1.0))
    plane, times, tip = (figure.add_subplot(grid[i]) for i in range(3))
    plane.add_patch(_box(tau_ms, age_ms))
    for axes, across in ((plane, None), (times, "t")):
        for verdict, chosen in by_verdict(run.receptions).items():
            color, marker = _LOOKS.get(verdict, (GRAY, "+"))
            # by_verdict has left out those of which a time is not known
            delays = [r.judgement.network_delay_ns / 1e6 for r in chosen]  # type: ignore[operator]
            ages = [r.judgement.age_ns / 1e6 for r in chosen]  # type: ignore[operator]
            name = f"{verdict.value.replace('_', ' ')} ({len(chosen)})"
            x, y = (delays, ages) if across is None else ([r.t4_ns / 1e9 for r in chosen], ages)
            axes.plot(x, y, marker, color=color, ms=4, label=name, alpha=0.8)
    plane.axvline(tau_ms, color=BLUE, ls="--", lw=1.0)
    plane.axhline(age_ms, color=BLUE, ls="--", lw=1.0)
    finish(plane, "each result", "d1 + d2, on the network [ms]", "age on arrival [ms]")
    legend(plane, loc="lower right")
    times.axhline(age_ms, color=BLUE, ls="--", lw=1.0)
    finish(times, "the same over time; dotted: the mission's phases", "", "age on arrival [ms]")
    _tip(tip, run)
    times.sharex(tip)
    for axes in (times, tip):
        axes.set_xlim(0.0, run.t_s[-1])
        mark_phases(axes, run.phases, wide=True)
    return figure, _caption(run, tau_ms, age_ms, slowed=link.slowed)


def by_verdict(receptions: tuple[Reception, ...]) -> dict[Verdict, list[Reception]]:
    """The results that both times are known of, by what the gate said."""
    found: dict[Verdict, list[Reception]] = {}
    for reception in receptions:
        judgement = reception.judgement
        if judgement.network_delay_ns is not None and judgement.age_ns is not None:
            found.setdefault(judgement.verdict, []).append(reception)
    return found


def _box(tau_ms: float, age_ms: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((0, 0), tau_ms, age_ms, facecolor=SKY, alpha=0.2, lw=0, label="the gate")


def _tip(axes: Any, run: Run) -> None:
    axes.plot(run.t_s, run.tip[:, 0], color=BLUE, lw=1.5)
    axes.axhline(0.0, color="black", lw=0.8)
    axes.set_ylim(-0.1, 2.0)
    named: set[Freshness] = set()
    for tick in run.flown.ticks:
        phase = None if tick.decision.safe is None else tick.decision.safe.freshness
        if phase in _PHASES:
            name = None if phase in named else _LEVELS[phase]
            named.add(phase)
            at_s = tick.t_ns / 1e9
            axes.axvspan(at_s, at_s + 0.02, color=_PHASES[phase], alpha=0.6, lw=0, label=name)
    finish(axes, "what the drone did; dotted: the mission's phases", "time [s]", "tip to board [m]")
    if named:
        legend(axes, loc="upper right", title="shaded: the filter's levels", title_fontsize=8)


def _shaded(run: Run) -> str:
    """What the filter made of the age of what it knew, of the levels that are shaded."""
    safe = [tick.decision.safe for tick in run.flown.ticks]
    seen = {s.freshness for s in safe if s is not None}
    does = [_LEVELS[level].split(": ")[1] for level in _LEVELS if level in seen]
    if not does:
        return "Nothing is shaded: the newest accepted one never gets old"
    words = " or ".join(filter(None, (", ".join(does[:-1]), does[-1])))
    return (
        "Shaded: what the safety filter makes of the age of the newest accepted one, whatever the "
        f"mission does: it {words}"
    )


def _caption(run: Run, tau_ms: float, age_ms: float, *, slowed: bool) -> str:
    counts = {verdict: len(found) for verdict, found in by_verdict(run.receptions).items()}
    refused = sum(n for verdict, n in counts.items() if verdict is not Verdict.ACCEPTED)
    unknown = len(run.receptions) - sum(counts.values())
    more = f"; of {unknown} more the times are not known" if unknown else ""
    slow = f"gets up to {2 * EXTRA_MS:.0f} ms slower for {SLOW_S:g} s while the tip closes in"
    if not slowed:
        slow = f"never gets slow, for no approach comes as near as {1e2 * SLOW_FROM_M:.0f} cm"
    o = run.flown.outcome
    phases = ", ".join(phase.value for _, phase in run.phases)
    end = "made contact" if o.touched else "made no contact"
    off = "" if o.offset_m is None else f", {1e3 * o.offset_m:.1f} mm beside the centre"
    return (
        f"A flight in the {run.world} (seed {run.seed}) whose link {slow}. Accepted is what took "
        f"at most {tau_ms:.0f} ms on the network and is at most {age_ms:.0f} ms old: "
        f"{counts.get(Verdict.ACCEPTED, 0)} results; {refused} were refused{more}. "
        f"{_shaded(run)}. Dotted: where the mission, which has phases of these names too, went "
        f"into its next: {phases}. It {end}{off}. Flown {MODEL_WORDS}."
    )
