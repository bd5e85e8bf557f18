"""What the drone's own eyes came to in a run: looks, what became of them, and bridges."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from drone_client.cbf.freshness import Freshness
from drone_client.onboard import LookVerdict
from drone_client.target import Source
from drone_client.truth import TruthEntry, normal_error_rad, position_error_m
from rgbd_wire.messages import pose_of


class Bridge(NamedTuple):
    """A stretch of control ticks that were flown on the drone's own eyes, with fresh poses."""

    start_ns: int
    end_ns: int
    """Last tick of it."""


def bridges(ticks: Sequence[dict[str, Any]]) -> list[Bridge]:
    """All bridges of a run's control ticks (lines of ``ticks.jsonl``), in order."""
    found: list[Bridge] = []
    start_ns: int | None = None
    end_ns = 0
    for tick in ticks:
        own = tick.get("target_source") == Source.ONBOARD.value
        if own and tick.get("freshness") == Freshness.FRESH.value:
            start_ns = tick["t_ns"] if start_ns is None else start_ns
            end_ns = tick["t_ns"]
        elif start_ns is not None:
            found.append(Bridge(start_ns, end_ns))
            start_ns = None
    if start_ns is not None:
        found.append(Bridge(start_ns, end_ns))
    return found


def summarise_onboard(
    looks: Sequence[dict[str, Any]], ticks: Sequence[dict[str, Any]], truth: Sequence[TruthEntry]
) -> dict[str, Any]:
    """The part ``onboard`` of a run's summary.

    Args:
        looks: lines of ``onboard.jsonl``: frames that came while the edge was not fresh.
        ticks: lines of ``ticks.jsonl``.
        truth: per capture; empty where nobody knows.
    """
    accepted = [k for k in looks if k["verdict"] == LookVerdict.ACCEPTED.value]
    spans = bridges(ticks)
    sources = Counter(t["target_source"] for t in ticks if "target_source" in t)
    fresh_onboard = sum(
        t.get("target_source") == Source.ONBOARD.value
        and t.get("freshness") == Freshness.FRESH.value
        for t in ticks
    )
    summary: dict[str, Any] = {
        "frames": len(looks),
        "accepted": len(accepted),
        "verdicts": dict(Counter(_reason(k) for k in looks).most_common(32)),
        "look_ms": _spread([k["look_ms"] for k in looks if k.get("look_ms") is not None]),
        "ticks_by_source": dict(sources),
        "share_of_ticks": round(fresh_onboard / len(ticks), 4) if ticks else 0.0,
        "bridges": len(spans),
        "longest_bridge_ms": max((s.end_ns - s.start_ns for s in spans), default=0) / 1e6,
    }
    if truth:
        summary["truth"] = _against_truth(accepted, truth)
    return summary


def _reason(look: dict[str, Any]) -> str:
    if look["verdict"] == LookVerdict.REFUSED.value and look.get("detail"):
        return f"{look['verdict']}: {look['detail']}"
    return str(look["verdict"])


def _against_truth(
    accepted: Sequence[dict[str, Any]], truth: Sequence[TruthEntry]
) -> dict[str, Any]:
    position_mm, normal_deg = [], []
    for line in accepted:
        if line["sequence"] < len(truth):
            entry = truth[line["sequence"]].camera_from_target
            seen = pose_of(tuple(line["camera_from_target"]))
            position_mm.append(1e3 * position_error_m(seen, entry))
            normal_deg.append(float(np.degrees(normal_error_rad(seen, entry))))
    return {"position_error_mm": _spread(position_mm), "normal_error_deg": _spread(normal_deg)}


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    """Median, 95th percentile and maximum; None if there is no value."""
    if not values:
        return None
    p50, p95, most = np.percentile(values, [50, 95, 100])
    return {name: round(float(v), 4) for name, v in (("p50", p50), ("p95", p95), ("max", most))}
