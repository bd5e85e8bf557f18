"""What a campaign came to, as numbers against their goals and as a page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

import numpy as np

from contact_sim.campaign.row import UNFINISHED, FlightRow

NONE: Final = "none"
Z95: Final = 1.959964


def wilson(hits: int, of: int) -> tuple[float, float]:
    """95 % confidence interval of a share (Wilson 1927)."""
    if of == 0:
        return 0.0, 1.0
    p = hits / of
    middle = p + Z95**2 / (2 * of)
    half = Z95 * math.sqrt(p * (1 - p) / of + Z95**2 / (4 * of**2))
    scale = 1 + Z95**2 / of
    return max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale)


def summary(rows: Sequence[FlightRow]) -> dict[str, Any]:
    """Some flights in numbers."""
    flown = [row for row in rows if not row.error]
    contacts = [row for row in flown if row.ends == "contact"]
    within = [row.offset_m for row in contacts if row.offset_m is not None]
    offsets = [row.offset_m for row in flown if row.offset_m is not None]
    return {
        "flights": len(flown),
        "failed": len(rows) - len(flown),
        "touched": len(offsets),
        "contact": len(contacts),
        "false_contact": sum(row.ends == "false_contact" for row in flown),
        "within_2cm": sum(o <= 0.02 for o in within),
        "within_1cm": sum(o <= 0.01 for o in within),
        "first_attempt": sum(row.attempts == 1 for row in contacts),
        "retreat": sum(row.ends == "retreat" for row in flown),
        "stands": sum(row.ends == "stands" for row in flown),
        "back_to_m": min((row.end_m for row in flown if row.ends == "retreat"), default=None),
        "no_approach": sum(row.ends == "no_approach" for row in flown),
        "touches": sum(row.ends == "touches" for row in flown),
        "unfinished": sum(row.ends == UNFINISHED for row in flown),
        "safe": sum(row.safe for row in flown),
        "collided": sum(bool(row.collisions) for row in flown),
        "outside": sum(row.outside_m > 0.0 for row in flown),
        "outside_mm": 1e3 * max((row.outside_m for row in flown), default=0.0),
        "offset_mm": _three(1e3 * o for o in offsets),
        "touch_age_ms": _three(1e3 * r.touch_age_s for r in flown if r.touch_age_s is not None),
        "closing_mps": _three(r.closing_mps for r in flown if r.closing_mps is not None),
        "peak_force_n": _three(r.peak_force_n for r in flown if r.touched),
        "flown_s": _three(row.flown_s for row in flown),
        "real_time_factor": _three(r.flown_s / r.wall_s for r in flown if r.wall_s > 0.0),
    }


def _three(values: Iterable[float]) -> dict[str, float] | None:
    """Median, 95th percentile and largest; None: there are none."""
    array = np.array([v for v in values if math.isfinite(v)])
    if array.size == 0:
        return None
    p50, p95 = np.percentile(array, (50, 95))
    return {"p50": float(p50), "p95": float(p95), "max": float(array.max())}


def by_group(rows: Sequence[FlightRow]) -> dict[tuple[str, str, str], list[FlightRow]]:
    """Rows by world, fault and ablation, in the order in which they were planned."""
    groups: dict[tuple[str, str, str], list[FlightRow]] = {}
    for row in rows:
        groups.setdefault((row.world, row.fault, row.ablation), []).append(row)
    return groups


def page(rows: Sequence[FlightRow], made_by: str, about: str) -> str:
    """A Markdown page.

    Args:
        rows: of all flights.
        made_by: the command that flew them.
        about: what they were flown with.
    """
    groups = {key: summary(of) for key, of in by_group(rows).items()}
    plain = {k[0]: s for k, s in groups.items() if k[1:] == (NONE, NONE)}
    faults = {k: s for k, s in groups.items() if k[1] != NONE and k[2] == NONE}
    ablations = {k: s for k, s in groups.items() if k[2] != NONE}
    lines = ["# Flights in the simulator", "", f"Made by `{made_by}`. {about}", ""]
    if plain:
        lines += _plain(plain)
    if faults:
        lines += _faults(faults)
    if ablations:
        lines += _ablations(groups)
    errors = [row for row in rows if row.error]
    if errors:
        lines += ["## Not flown", ""]
        lines += [f"- {r.world}, seed {r.seed}, {r.fault}: {r.error}" for r in errors[:20]]
        lines += [f"- and {len(errors) - 20} more"] if len(errors) > 20 else []
        lines.append("")
    return "\n".join(lines)


def _plain(worlds: dict[str, dict[str, Any]]) -> list[str]:
    names = list(worlds)
    lines = [
        "## Without faults",
        "",
        "In brackets: 95 % confidence intervals (Wilson). Offsets are of the first touch, in the "
        "truth.",
        "",
        "| | goal | " + " | ".join(names) + " |",
        "| --- | --- |" + " --- |" * len(names),
    ]

    def row(title: str, goal: str, cell: Callable[[dict[str, Any]], str]) -> str:
        return f"| {title} | {goal} | " + " | ".join(cell(worlds[n]) for n in names) + " |"

    return [
        *lines,
        row("flights", "100", lambda s: str(s["flights"])),
        row("contact within 2 cm", ">= 98 %", lambda s: _share(s["within_2cm"], s["flights"])),
        row("contact within 1 cm", ">= 80 %", lambda s: _share(s["within_1cm"], s["flights"])),
        row("took for contact what was none", "0", lambda s: str(s["false_contact"])),
        row("never began an approach", "0", lambda s: str(s["no_approach"])),
        row("at the first attempt", "", lambda s: _share(s["first_attempt"], s["flights"])),
        row("offset [mm], p50 / p95 / max", "", lambda s: _cell(s["offset_mm"], ".1f")),
        row("age of what it knew [ms]", "<= 300", lambda s: _cell(s["touch_age_ms"], ".0f")),
        row("contact speed [m/s]", "p95 <= 0.05", lambda s: _cell(s["closing_mps"], ".3f")),
        row("contact force [N]", "p95 <= 5", lambda s: _cell(s["peak_force_n"], ".2f")),
        row("body or propeller touched anything", "0", lambda s: str(s["collided"])),
        row("push outside the mouth", "0", lambda s: str(s["outside"])),
        row("flight time [s]", "", lambda s: _cell(s["flown_s"], ".0f")),
        row("real-time factor", "", lambda s: _cell(s["real_time_factor"], ".1f")),
        "",
    ]


def _faults(faults: dict[tuple[str, str, str], dict[str, Any]]) -> list[str]:
    lines = [
        "## With a fault in the approach",
        "",
        "Each strikes once, at a random distance from the board. *Contact*: touched and back all "
        "the same. *Retreat*: back without, *to* at least so far from the board. *Stands*: given "
        "back nearer than half the stand-off distance, clear of the board. *On the board*: given "
        "back while it touches. *False*: back from a contact that was none. *None*: it never began "
        "an approach. *Not over*: not given back when time was up.",
        "",
        "| world | fault | flights | contact | retreat | to [m] | stands | on the board | false "
        "| none | not over | touched anything else | push outside the mouth | deepest [mm] "
        "| force [N], p50 / p95 / max |",
        "| --- | --- |" + " ---: |" * 12 + " --- |",
    ]
    for (world, fault, _), s in faults.items():
        force = _cell(s["peak_force_n"], ".2f")
        back = "-" if s["back_to_m"] is None else f"{s['back_to_m']:.2f}"
        lines.append(
            f"| {world} | {fault.replace('_', ' ')} | {s['flights']} | {s['contact']} | "
            f"{s['retreat']} | {back} | {s['stands']} | {s['touches']} | {s['false_contact']} | "
            f"{s['no_approach']} | {s['unfinished']} | "
            f"{s['collided']} | {s['outside']} | {s['outside_mm']:.1f} | {force} |"
        )
    return [*lines, ""]


def _ablations(groups: dict[tuple[str, str, str], dict[str, Any]]) -> list[str]:
    titles = {
        NONE: "nothing",
        "composes_now": "composing at the exposure (instead: with the pose at arrival)",
        "no_gate": "the delay gate",
        "no_age": "the delay gate and the age in the margin (closes in on what is 2 s old)",
        "no_funnel": "the funnel (a mouth of 0.5 m)",
    }
    lines = [
        "## Without a part of the contract",
        "",
        "The same flights without a part. *Touched*: however it ended; offset and age are of "
        "these. *Contact*: touched, kept it, and back. *Age* is that of the newest measurement at "
        "the touch.",
        "",
        "| world | fault | without | flights | touched | contact | within 2 cm "
        "| offset [mm], p50 / p95 / max | age [ms], p50 / p95 / max "
        "| push outside the mouth | deepest [mm] "
        "| touched anything else |",
        "| --- | --- | --- | ---: | ---: | --- | --- | --- | --- | ---: | ---: | ---: |",
    ]
    lacking = {key[:2] for key in groups if key[2] != NONE}
    # What is compared stands together: by world and fault, and first what lacks nothing
    for key in sorted((k for k in groups if k[:2] in lacking), key=lambda k: (k[0], k[1])):
        s, (world, fault, ablation) = groups[key], key
        lines.append(
            f"| {world} | {fault.replace('_', ' ')} | {titles.get(ablation, ablation)} | "
            f"{s['flights']} | {s['touched']} | {_share(s['contact'], s['flights'])} | "
            f"{_share(s['within_2cm'], s['flights'])} | {_cell(s['offset_mm'], '.1f')} | "
            f"{_cell(s['touch_age_ms'], '.0f')} | {s['outside']} | {s['outside_mm']:.1f} | "
            f"{s['collided']} |"
        )
    return [*lines, ""]


def _share(hits: int, of: int) -> str:
    if of == 0:
        return "-"
    low, high = wilson(hits, of)
    return f"{100 * hits / of:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def _cell(three: dict[str, float] | None, form: str) -> str:
    if three is None:
        return "-"
    return " / ".join(format(three[k], form) for k in ("p50", "p95", "max"))
