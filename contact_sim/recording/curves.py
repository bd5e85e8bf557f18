"""h, d1 + d2 against its limit, and the force of the tip, over the whole flight, with a cursor."""

from __future__ import annotations

from bisect import bisect_right
from itertools import groupby
from typing import Any, Final

import numpy as np

from contact_sim.recording.ink import AMBER, GREEN, GREY, PAPER, RED, WHITE, Color, Picture, write
from contact_sim.recording.panels import PHASE_COLORS
from contact_sim.recording.reel import Instant, Reel
from drone_client.viewing.moments import Settled

DPI: Final = 100
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 46, 232, 22, 24
FUTURE: Final = 0.45
"""What has not happened yet is so much darker."""
H_LINEAR_M: Final = 0.1
"""Up to here the barrier is drawn to scale, beyond it by its logarithm: near zero it counts."""
LEAST_MS, MOST_TAU = 1.0, 2.0
"""Delays are drawn from here to so many times the limit; what is beyond lies on the edge."""
BLUE: Final[Color] = (95, 165, 255)
_SHARES: Final = (3, 3, 2)
"""Of the height, of the three curves."""


class Curves:
    """The strip below a film's windows: drawn once, then only the cursor moves."""

    def __init__(self, reel: Reel, width: int, height: int) -> None:
        self._reel = reel
        self._span_ns = reel.end_ns - reel.start_ns
        self._plot_px = width - LEFT_PX - RIGHT_PX
        self._answer_ns = [a.t_ns for a in reel.answers]
        room = height - TOP_PX - BOTTOM_PX
        edges = TOP_PX + np.cumsum((0, *_SHARES)) * room / sum(_SHARES)
        self._rows_px = [int(edge) for edge in edges]
        self._drawn = self._draw(width, height)

    def at(self, instant: Instant) -> Picture:
        """The strip at a moment."""
        picture = self._drawn.copy()
        share = (instant.t_ns - self._reel.start_ns) / self._span_ns
        x = LEFT_PX + round(self._plot_px * min(1.0, max(0.0, share)))
        top, bottom = self._rows_px[0], self._rows_px[-1]
        future = picture[:bottom, x : LEFT_PX + self._plot_px]
        future[:] = (future * np.float32(FUTURE)).astype(np.uint8)
        picture[top:bottom, x : x + 1] = WHITE
        self._write_values(picture, instant)
        return picture

    def _write_values(self, picture: Picture, instant: Instant) -> None:
        x = picture.shape[1] - RIGHT_PX + 16
        y = [row + 20 for row in self._rows_px]
        tick = {} if instant.tick is None else instant.tick.line
        h, robust = tick.get("h_m"), tick.get("h_robust_m")
        write(picture, f"h {_signed(h)} m", (x, y[0]), 16, BLUE)
        write(picture, f"certain {_signed(robust)} m", (x, y[0] + 22), 16, AMBER)
        if (status := tick.get("status")) is not None:
            write(picture, f"filter {str(status).replace('_', ' ')}", (x, y[0] + 43), 13, GREY)
        answer = self._newest_answer(instant.t_ns)
        delay = None if answer is None else answer.line.get("network_delay_ms")
        if answer is not None and delay is not None:
            color = GREEN if answer.accepted else RED
            write(picture, f"d1 + d2 {delay:.0f} ms", (x, y[1]), 16, color)
        age = tick.get("target_age_ms")
        if age is not None:
            shown = f"{age:.0f} ms" if age < 10_000 else f"{age / 1e3:.0f} s"
            write(picture, f"target known {shown} ago", (x, y[1] + 22), 14, GREY)
        truth = instant.truth
        write(picture, f"force {truth.tip_force_n:.1f} N", (x, y[2]), 16, WHITE)
        write(picture, f"arm {max(0.0, 1e3 * truth.arm_m):.0f} mm in", (x, y[2] + 20), 13, GREY)

    def _newest_answer(self, t_ns: int) -> Settled | None:
        """The newest answer that has a delay; those before it stood on the screen for a moment."""
        number = bisect_right(self._answer_ns, t_ns) - 1
        for answer in reversed(self._reel.answers[max(0, number - 30) : number + 1]):
            if answer.line.get("network_delay_ms") is not None:
                return answer
        return None

    def _draw(self, width: int, height: int) -> Picture:
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import
        from matplotlib.figure import Figure

        figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor=_hex(PAPER))
        canvas = FigureCanvasAgg(figure)
        axes = []
        for above, below in zip(self._rows_px, self._rows_px[1:], strict=False):
            box = (
                LEFT_PX / width,
                1.0 - (below - 3) / height,
                self._plot_px / width,
                (below - above - 6) / height,
            )
            axes.append(figure.add_axes(box, facecolor=_hex(PAPER)))
        barrier, link, force = axes
        self._draw_barrier(barrier)
        self._draw_link(link)
        self._draw_force(force)
        self._draw_phases(axes)
        for one in axes:
            one.set_xlim(0.0, self._span_ns / 1e9)
            one.tick_params(colors=_hex(GREY), labelsize=8, length=2, labelbottom=one is force)
            one.grid(alpha=0.15)
            for spine in one.spines.values():
                spine.set_color(_hex(GREY))
                spine.set_linewidth(0.4)
        force.set_xlabel("s", fontsize=8, color=_hex(GREY), labelpad=-8, loc="right")
        canvas.draw()
        return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])

    def _seconds(self, t_ns: int) -> float:
        return (t_ns - self._reel.start_ns) / 1e9

    def _draw_barrier(self, axes: Any) -> None:
        lines = [t.line for t in self._reel.ticks]
        times = [self._seconds(t.t_ns) for t in self._reel.ticks]
        for name, color in (("h_m", BLUE), ("h_robust_m", AMBER)):
            values = [np.nan if (v := line.get(name)) is None else float(v) for line in lines]
            axes.plot(times, values, color=_hex(color), lw=1.2)
        axes.axhline(0.0, color=_hex(RED), lw=0.8)
        known = [
            v for line in lines for n in ("h_m", "h_robust_m") if (v := line.get(n)) is not None
        ]
        axes.set_yscale("symlog", linthresh=H_LINEAR_M, linscale=1.0)
        axes.set_ylim(min([-H_LINEAR_M, *known]) * 1.1, max([1.0, *known]) * 1.3)
        axes.set_yticks([-1.0, -0.1, 0.0, 0.1, 1.0], ["-1", "-0.1", "0", "0.1", "1"])
        axes.set_ylim(min([-H_LINEAR_M, *known]) * 1.1, max([1.0, *known]) * 1.3)
        _name(axes, "h [m]")

    def _draw_link(self, axes: Any) -> None:
        tau_ms = self._reel.facts.tau_max_ms
        for keep, color in ((True, GREEN), (False, RED)):
            chosen = [
                a
                for a in self._reel.answers
                if a.accepted is keep
                and a.verdict != "not_looked_at"
                and a.line.get("network_delay_ms") is not None
            ]
            axes.plot(
                [self._seconds(a.t_ns) for a in chosen],
                [
                    min(max(float(a.line["network_delay_ms"]), LEAST_MS), MOST_TAU * tau_ms)
                    for a in chosen
                ],
                ".",
                color=_hex(color),
                ms=3,
            )
        axes.axhline(tau_ms, color=_hex(GREY), lw=0.9, ls="--")
        axes.annotate(
            f"tau_max {tau_ms:g} ms",
            (1.0, tau_ms),
            xycoords=("axes fraction", "data"),
            xytext=(-4, 2),
            textcoords="offset points",
            ha="right",
            fontsize=8,
            color=_hex(GREY),
        )
        axes.set_yscale("log")
        axes.set_ylim(0.8 * LEAST_MS, 1.3 * MOST_TAU * tau_ms)
        axes.set_yticks([1.0, 10.0, 100.0], ["1", "10", "100"])
        axes.minorticks_off()
        _name(axes, "d1 + d2 [ms]")

    def _draw_force(self, axes: Any) -> None:
        times = [self._seconds(m.t_ns) for m in self._reel.truths]
        forces = [m.tip_force_n for m in self._reel.truths]
        axes.fill_between(times, forces, color=_hex(WHITE), alpha=0.8, lw=0.8)
        axes.set_ylim(0.0, max(2.0, 1.2 * max(forces)))
        axes.locator_params(axis="y", nbins=3, integer=True, prune="upper")
        _name(axes, "force [N]")

    def _draw_phases(self, axes: list[Any]) -> None:
        """Shade the phases of the mission, and name them above where there is room."""
        ticks = self._reel.ticks
        for phase, group in groupby(ticks, key=lambda t: t.line.get("phase")):
            these = list(group)
            start = max(0.0, self._seconds(these[0].t_ns))
            end = min(self._seconds(these[-1].t_ns), self._span_ns / 1e9)
            if phase is None or end <= start:
                continue
            color = _hex(PHASE_COLORS.get(str(phase), GREY))
            for one in axes:
                one.axvspan(start, end, color=color, alpha=0.16, lw=0)
            if (end - start) / (self._span_ns / 1e9) * self._plot_px > 7 * len(str(phase)):
                axes[0].annotate(
                    str(phase),
                    ((start + end) / 2, 1.0),
                    xycoords=("data", "axes fraction"),
                    xytext=(0, 3),
                    textcoords="offset points",
                    ha="center",
                    fontsize=9,
                    color=color,
                )


def _name(axes: Any, name: str) -> None:
    axes.annotate(
        name,
        (0.0, 1.0),
        xycoords="axes fraction",
        xytext=(6, -4),
        textcoords="offset points",
        va="top",
        fontsize=9,
        color=_hex(WHITE),
    )


def _hex(color: Color) -> str:
    r, g, b = color
    return f"#{r:02x}{g:02x}{b:02x}"


def _signed(value: float | None) -> str:
    return "?" if value is None else f"{value:+.3f}"
