"""A run's summary as people read it: one row for each thing, warnings last."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from drone_client.ledger import Fate

MANY = 0.1
"""Share of the frames from which on a fate is worth a sentence."""


def print_summary(summary: dict[str, Any]) -> None:
    """Print the table of a run."""
    print_rows(summary_rows(summary))


def print_rows(rows: dict[str, str], title: str | None = None) -> None:
    """Print rows with their names; a title stands above them."""
    table = Table(show_header=False, box=None, pad_edge=False, title=title, title_justify="left")
    for key, value in rows.items():
        table.add_row(Text(key, style="bold"), Text(value))
    Console().print(table)


def summary_rows(summary: dict[str, Any]) -> dict[str, str]:
    """Text of each row by its name, of what ``replay`` gives back."""

    def counts(name: str) -> str:
        return ", ".join(f"{n} {key}" for key, n in summary[name].items()) or "none"

    def times(name: str) -> str:
        s = summary[name]
        return (
            "none" if s is None else f"p50 {s['p50']:.1f}  p95 {s['p95']:.1f}  max {s['max']:.1f}"
        )

    rows = {
        "frames": f"{summary['frames']}: {counts('fates')}",
        "gate": counts("verdicts"),
        "outcomes": counts("outcomes"),
        "workers": counts("workers"),
        "target": counts("updates"),
        "encodings": counts("encodings"),
        "d1 + d2 [ms]": (
            f"{times('network_delay_ms')}  of accepted (tau_max {summary['tau_max_ms']:g})"
        ),
        "age [ms]": f"{times('age_ms')}  of accepted (age_max {summary['age_max_ms']:g})",
        "service [ms]": times("service_ms"),
        "control ticks": f"{summary['ticks']}: {counts('known')}",
        "filter": counts("statuses"),
        "knowledge": counts("freshness"),
    }
    if (phase := summary.get("phase")) is not None:
        rows = {"mission": _mission(summary, phase)} | rows
    if (own := summary.get("onboard")) is not None:
        rows |= _onboard_rows(own)
    if (t := summary.get("truth")) is not None:
        error_mm = t["position_error_mm"]
        rows["against truth"] = (
            f"found {t['found_of_these']} of {t['frames_fully_visible']} in full view, "
            f"{t['ghosts_in_these']} ghosts in {t['frames_without_target']} without it"
            + ("" if error_mm is None else f", median error {error_mm['p50']:.1f} mm")
        )
    if summary["rejected_messages"]:
        rows["bad messages"] = counts("rejected_messages")
    if summary["hand_overs"]:
        rows["hand-overs"] = (
            f"{summary['hand_overs']}; suspicions: {counts('suspicions')}; "
            f"second copies: {counts('copies')}"
        )
    if (d1 := summary["d1_ms"]) is not None:
        rows["d1, d2 apart [ms]"] = (
            f"p50 {d1['p50']:.1f}, {summary['d2_ms']['p50']:.1f}, each within "
            f"{summary['one_way_bound_ms']['p50']:.1f} (to look at; the gate never asks)"
        )
    return rows | _tunnel_rows(summary["link"]) | _warnings(summary)


def _mission(summary: dict[str, Any], phase: str) -> str:
    """How a flight ended."""
    attempts = summary["attempts"]
    how = f"{phase} ({summary['reason']}), {attempts} approach{'es' * (attempts != 1)}"
    if summary["dry_run"]:
        return f"{how}; dry run, nothing was sent"
    return how if summary["agreed"] else f"nobody agreed to it; {how}"


def _onboard_rows(own: dict[str, Any]) -> dict[str, str]:
    """What the drone saw by itself."""
    verdicts = ", ".join(f"{n} {key}" for key, n in own["verdicts"].items()) or "none"
    rows = {"own eyes": f"{own['frames']} frames without a fresh result: {verdicts}"}
    if n := own.get("taken_back"):
        rows["TAKEN BACK"] = f"{n} times the edge disagreed, late, with what was seen on board"
    if own["bridges"]:
        took = own["look_ms"]
        rows["bridges"] = (
            f"{own['bridges']}, longest {own['longest_bridge_ms'] / 1e3:.2f} s; "
            f"{own['share_of_ticks']:.1%} of all ticks flown on own eyes"
            + ("" if took is None else f"; a look takes {took['p50']:.0f} ms")
        )
    return rows


def _tunnel_rows(link: dict[str, Any]) -> dict[str, str]:
    """What the tunnel knows of each worker's way; its 0 is a rate or time not yet measured."""
    rows = {}
    for worker, state in link.get("workers", {}).items():
        if state is None:
            rows[f"tunnel to {worker}"] = "unknown"
            continue
        goodput, round_trip = state["goodput_mbps"], state["round_trip_ms"]
        rows[f"tunnel to {worker}"] = (
            (f"{goodput:.1f} Mbit/s" if goodput else "goodput unknown")
            + (f", round trip {round_trip:.1f} ms" if round_trip else ", round trip unknown")
            + f", loss {state['loss']:.1%}, parity {state['parity']:.0%}"
        )
    return rows


def _warnings(summary: dict[str, Any]) -> dict[str, str]:
    """What a person has to know of a run, and would not see in its counts."""
    rows = {}
    if summary.get("interrupted"):  # of a replay alone
        rows["INTERRUPTED"] = "the recording was not played to its end"
    same_name = []
    if n := summary["foreign_messages"]:
        same_name.append(
            f"{n} answers were for another client called {summary['drone']!r}: the two displace "
            "each other's frames; give each its own --name"
        )
    if workers := summary.get("same_name_workers"):
        same_name.append(
            f"more than one worker is called {', '.join(map(repr, workers))}: they take each "
            "other's frames; start each with its own --name (EDGE_NAME)"
        )
    if same_name:
        rows["SAME NAME"] = "; ".join(same_name)
    late = summary["fates"].get(Fate.TOO_OLD_ON_BOARD.value, 0)
    if late and late >= MANY * summary["frames"]:
        rows["ROUND TRIP"] = (
            f"{_round_trip(summary['link'])} nothing of age_max {summary['age_max_ms']:g} ms for "
            f"{late} of {summary['frames']} frames, which were not sent: raise --age-max-ms, or "
            "use a nearer worker"
        )
    if n := summary["updates"].get("no_pose"):
        rows["NO POSE"] = (
            f"{n} targets were not used, since the drone did not know where it was: "
            "groundtruth.txt is missing, or does not cover the recording"
        )
    if n := summary["lost_ledger_lines"]:
        rows["LOST LINES"] = f"{n} (is the disk full?)"
    if summary["unwritten"]:
        rows["UNWRITTEN"] = "; ".join(summary["unwritten"])
    return rows


def _round_trip(link: dict[str, Any]) -> str:
    """What took the time, with its length where the link knows one."""
    known = [s["round_trip_ms"] for s in link.get("workers", {}).values() if s is not None]
    if any(known):
        return f"{max(known):.0f} ms, and the time on board, leave"
    return "the way to the worker and back, and the time on board, leave"
