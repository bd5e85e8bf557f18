"""The picture of a run: delays against the gate, the barrier, the commands, one time axis."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from drone_client.gate import Verdict
from drone_client.ledger import Fate
from drone_client.onboard_summary import bridges
from drone_client.viewing.whole_file import write_whole

_CHOSEN_COLORS = {
    Fate.SUPERSEDED_ON_BOARD: "tab:gray",
    Fate.TOO_OLD_ON_BOARD: "tab:cyan",
    Fate.SEND_FAILED: "tab:olive",
    Fate.NO_WORKER: "tab:purple",
    Fate.NO_REPLY: "tab:red",
    Fate.INTERRUPTED: "tab:brown",
}
# Black for a fate that has no colour of its own: it is drawn all the same
_FATE_COLORS = {
    fate.value: _CHOSEN_COLORS.get(fate, "black") for fate in Fate if fate is not Fate.ANSWERED
} | {Verdict.NOT_LOOKED_AT.value: "tab:pink"}
_OWN_EYES_COLOR = "tab:cyan"
_FRESHNESS_COLORS = {"hold": "gold", "brake": "orange", "retreat": "tab:red"}


def plot_run(
    path: Path,
    frames: Sequence[dict[str, Any]],
    ticks: Sequence[dict[str, Any]],
    events: Sequence[dict[str, Any]],
    tau_max_ms: float,
    age_max_ms: float,
) -> None:
    """Draw a run from its ledger lines into a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import
    from matplotlib.figure import Figure

    stamps = [f["t_capture_ns"] for f in frames] or [t["t_ns"] for t in ticks]
    start_ns = min(stamps, default=0)  # waiting for a worker is not worth half a picture

    def seconds(t_ns: int) -> float:
        return (t_ns - start_ns) / 1e9

    figure = Figure(figsize=(11, 12), layout="constrained")
    FigureCanvasAgg(figure)
    delays, sizes, barrier, tip, commands = figure.subplots(5, 1, sharex=True)

    ignored = Verdict.NOT_LOOKED_AT.value
    answered = [f for f in frames if f["fate"] == "answered" and f["age_ms"] is not None]
    for label, keep, marker in (
        ("accepted", True, "o"),
        ("refused by the gate", False, "x"),
    ):
        chosen = [
            f
            for f in answered
            if f["verdict"] != ignored and (f["verdict"] == Verdict.ACCEPTED.value) is keep
        ]
        times = [seconds(f["t_capture_ns"]) for f in chosen]
        delays.plot(
            times,
            [f["network_delay_ms"] for f in chosen],
            marker,
            color="tab:blue",
            ms=4,
            label=f"d1 + d2, {label}",
        )
        delays.plot(
            times,
            [f["age_ms"] for f in chosen],
            marker,
            color="tab:green",
            ms=4,
            label=f"age on arrival, {label}",
        )
    delays.axhline(tau_max_ms, color="tab:blue", ls="--", lw=1, label=r"$\tau_{max}$")
    delays.axhline(age_max_ms, color="tab:green", ls="--", lw=1, label=r"age$_{max}$")
    for fate, color in _FATE_COLORS.items():
        times = [
            seconds(f["t_capture_ns"]) for f in frames if fate in (f["fate"], f.get("verdict"))
        ]
        if times:
            delays.plot(times, [0.0] * len(times), "|", color=color, ms=12, mew=2, label=fate)
    delays.set_title("what the link delivered, against the gate", fontsize=9, loc="left")
    delays.set_ylabel("ms")
    delays.set_ylim(bottom=-0.05 * age_max_ms)
    _legend(delays)

    _plot_sizes(sizes, frames, seconds)
    _mark_hand_overs((delays, sizes, barrier), events, seconds)

    times = [seconds(t["t_ns"]) for t in ticks]

    def column(name: str, index: int | None = None) -> list[float]:
        values = [t.get(name) for t in ticks]
        return [float("nan") if v is None else (v if index is None else v[index]) for v in values]

    barrier.plot(times, column("h_m"), color="tab:blue", label="h at the estimated tip")
    barrier.plot(times, column("h_robust_m"), color="tab:orange", label="h that is certain")
    barrier.axhline(0.0, color="black", lw=0.8)
    _shade_what_was_known((barrier, tip), ticks, seconds)
    barrier.set_title("the barrier: safe above 0", fontsize=9, loc="left")
    barrier.set_ylabel("m")
    _legend(barrier)

    for index, axis in enumerate("xyz"):
        tip.plot(times, column("tip_target_m", index), label=f"tip {axis}")
        commands.plot(times, column("command_mps", index), label=f"velocity {axis}")
    tip.set_title("end of the arm, seen from the target", fontsize=9, loc="left")
    tip.set_ylabel("m")
    _legend(tip)
    commands.plot(times, column("yaw_rate_radps"), color="tab:gray", label="yaw rate [rad/s]")
    commands.set_title("what the drone was told, in the world", fontsize=9, loc="left")
    commands.set_ylabel("m/s")
    if frames:
        commands.set_xlim(left=-0.2)
    commands.set_xlabel("s")
    _legend(commands)
    for axes in (delays, sizes, barrier, tip, commands):
        axes.grid(alpha=0.3)
    _write(path, figure)


def _write(path: Path, figure: Any) -> None:
    """Half a picture on a full disk would look like one."""
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=110, format="png")
    write_whole(path, drawn.getvalue())


def _plot_sizes(
    axes: Any, frames: Sequence[dict[str, Any]], seconds: Callable[[int], float]
) -> None:
    """What each frame weighed, by its encoding, beside what the link was thought to carry."""
    sent = sorted((f for f in frames if f["encoding"] is not None), key=lambda f: f["t1_ns"])
    for rung in dict.fromkeys(f["encoding"]["rung"] for f in sent):
        mine = [f for f in sent if f["encoding"]["rung"] == rung]
        times = [seconds(f["t1_ns"]) for f in mine]
        axes.plot(times, [f["bytes"] / 1e3 for f in mine], ".", ms=5, label=rung)
    known = [f for f in sent if f["encoding"]["goodput_mbps"] is not None]
    if known:
        right = axes.twinx()
        goodput = [f["encoding"]["goodput_mbps"] for f in known]
        right.plot([seconds(f["t1_ns"]) for f in known], goodput, color="tab:gray", lw=1)
        right.set_ylabel("goodput, Mbit/s", color="tab:gray")
        right.set_yscale("log")
        right.yaxis.set_major_formatter("{x:g}")
        right.yaxis.set_minor_formatter("{x:g}")
        right.tick_params(axis="y", which="both", labelsize=7)
    axes.set_title("what a frame weighed, by its encoding", fontsize=9, loc="left")
    axes.set_ylabel("kB")
    axes.set_ylim(0, 1.15 * max((f["bytes"] for f in sent), default=1e3) / 1e3)
    if sent:
        _legend(axes, 1.08 if known else 1.01)


def _legend(axes: Any, left: float = 1.01) -> None:
    """Beside the axes, where it covers no point; ``left`` is in widths of the axes."""
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(left, 1.0), borderaxespad=0.0)


def _mark_hand_overs(
    panels: Sequence[Any], events: Sequence[dict[str, Any]], seconds: Callable[[int], float]
) -> None:
    """A line where the drone went to another worker, with its name in the first panel."""
    for event in events:
        if event["event"] != "worker" or event["before"] is None:
            continue
        at = seconds(event["t_ns"])
        for axes in panels:
            axes.axvline(at, color="tab:purple", ls=":", lw=1)
        name = event["now"] or "nobody"
        panels[0].annotate(
            f"to {name}",
            (at, 1.0),
            xycoords=("data", "axes fraction"),
            rotation=90,
            va="top",
            ha="right",
            fontsize=7,
            color="tab:purple",
        )


def _name_phases(
    axes: Any, ticks: Sequence[dict[str, Any]], seconds: Callable[[int], float]
) -> None:
    """A line where a mission went into another phase, with the phase's name."""
    before = None
    for tick in ticks:
        phase = tick.get("phase")
        if phase is not None and phase != before:
            at = seconds(tick["t_ns"])
            axes.axvline(at, color="tab:gray", ls=":", lw=1)
            axes.annotate(
                phase,
                (at, 1.0),
                xycoords=("data", "axes fraction"),
                rotation=90,
                va="top",
                ha="left",
                fontsize=7,
                color="tab:gray",
            )
        before = phase


def _shade_what_was_known(
    panels: Sequence[Any], ticks: Sequence[dict[str, Any]], seconds: Callable[[int], float]
) -> None:
    """Shade, in the first panel, what was not fresh, in all what was flown on own eyes; phases."""
    _name_phases(panels[-1], ticks, seconds)
    times = [seconds(t["t_ns"]) for t in ticks]
    _shade(panels[0], times, [t.get("freshness") for t in ticks])
    for number, bridge in enumerate(bridges(ticks)):
        for axes in panels:
            axes.axvspan(
                seconds(bridge.start_ns),
                seconds(bridge.end_ns),
                color=_OWN_EYES_COLOR,
                alpha=0.2,
                lw=0,
                label=None if number else "own eyes",
            )


def _shade(axes: Any, times: Sequence[float], phases: Sequence[str | None]) -> None:
    """Shade the stretches in which what is known was not fresh; name each phase once."""
    named: set[str] = set()
    start = 0
    for i in range(1, len(phases) + 1):
        if i < len(phases) and phases[i] == phases[start]:
            continue
        phase = phases[start]
        if phase in _FRESHNESS_COLORS:
            axes.axvspan(
                times[start],
                times[min(i, len(times) - 1)],
                color=_FRESHNESS_COLORS[phase],
                alpha=0.25,
                lw=0,
                label=None if phase in named else phase,
            )
            named.add(phase)
        start = i
