"""What a run came to: ``summary.json``, from the ledger's own lines and the counts beside them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drone_client.gate import Verdict
from drone_client.onboard_summary import summarise_onboard
from drone_client.truth import TruthEntry, normal_error_rad, position_error_m
from rgbd_wire.messages import Outcome, pose_of

FULLY_VISIBLE = 0.9
"""Share of the target inside the picture from which on it must be found."""


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The JSON lines of a file; one that a full disk cut off is left out."""
    lines = []
    with path.open(encoding="utf-8") as file:
        for line in file:
            try:
                lines.append(json.loads(line))
            except ValueError:
                continue
    return lines


def summarise(
    frames: Sequence[dict[str, Any]],
    ticks: Sequence[dict[str, Any]],
    events: Sequence[dict[str, Any]],
    truth: Sequence[TruthEntry],
    looks: Sequence[dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Summary of a ledger.

    Args:
        frames: lines of ``ledger.jsonl``.
        ticks: lines of ``ticks.jsonl``.
        events: lines of ``events.jsonl``.
        truth: per capture; empty where nobody knows.
        looks: lines of ``onboard.jsonl``; None: the drone had no eyes of its own.
    """
    answered = [f for f in frames if f["fate"] == "answered"]
    accepted = [f for f in answered if f["verdict"] == Verdict.ACCEPTED.value]
    targets = [f for f in accepted if f["outcome"] == Outcome.TARGET.value]
    coded = [f["encoding"] for f in frames if f["encoding"] is not None]
    sent = [f["bytes"] for f in frames if f["bytes"] is not None]
    summary: dict[str, Any] = {
        "frames": len(frames),
        "fates": _counts(f["fate"] for f in frames),
        "verdicts": _counts(f["verdict"] for f in answered),
        "outcomes": _counts(f["outcome"] for f in answered),
        "reasons": _counts(f["reason"] for f in answered if f["reason"]),
        "updates": _counts(f["update"] for f in targets),
        "methods": _counts(f["method"] for f in targets),
        "workers": _counts(f["worker"] for f in answered),
        "hand_overs": sum(e["event"] == "worker" and e["before"] is not None for e in events),
        "suspicions": _counts(e["why"] for e in events if e["event"] == "suspect"),
        "copies": _counts(e["why"] for e in events if e["event"] == "copy"),
        "encodings": _counts(e["rung"] for e in coded),
        "encoding_reasons": _counts(e["reason"] for e in coded),
        "accepted": len(accepted),
        "accepted_poses": len(targets),
        "network_delay_ms": spread([f["network_delay_ms"] for f in accepted]),
        "d1_ms": spread([f["d1_ms"] for f in accepted]),
        "d2_ms": spread([f["d2_ms"] for f in accepted]),
        "one_way_bound_ms": spread([f["one_way_bound_ms"] for f in accepted]),
        "age_ms": spread([f["age_ms"] for f in accepted]),
        "service_ms": spread(
            [f["service_ms"] for f in answered if f["network_delay_ms"] is not None]
        ),
        "stages_ms": _stages(answered),
        "frame_bytes": spread(sent),
        "ticks": len(ticks),
        "known": _counts(t["known"] for t in ticks),
        "freshness": _counts(t["freshness"] for t in ticks if "freshness" in t),
        "statuses": _counts(t["status"] for t in ticks if "status" in t),
        "h_min_m": min((t["h_m"] for t in ticks if t.get("h_m") is not None), default=None),
        "onboard": None if looks is None else summarise_onboard(looks, ticks, truth),
    }
    if truth:
        summary["truth"] = _against_truth(frames, truth)
    return summary


def spread(values: Iterable[float | None]) -> dict[str, float] | None:
    """Median, 95th and 99th percentile and maximum; None if there is no value."""
    numbers = np.array([v for v in values if v is not None], dtype=np.float64)
    if not numbers.size:
        return None
    p50, p95, p99 = np.percentile(numbers, [50, 95, 99])
    named = {"p50": p50, "p95": p95, "p99": p99, "max": numbers.max()}
    return {name: round(float(v), 4) for name, v in named.items()}


def _counts(values: Iterable[str], at_most: int = 32) -> dict[str, int]:
    return dict(Counter(values).most_common(at_most))


def _stages(answered: Sequence[dict[str, Any]]) -> dict[str, dict[str, float] | None]:
    names = dict.fromkeys(name for f in answered for name in f["stages_ms"])
    return {name: spread([f["stages_ms"].get(name) for f in answered]) for name in names}


def _against_truth(frames: Sequence[dict[str, Any]], truth: Sequence[TruthEntry]) -> dict[str, Any]:
    """Found where it is, not found where it is not, and how far off; over frames looked at."""
    position_mm, normal_deg, fully, found, unseen, ghosts = [], [], 0, 0, 0, 0
    for frame in frames:
        if frame["fate"] != "answered" or frame["sequence"] >= len(truth):
            continue
        if not Outcome(frame["outcome"]).looked_at:
            continue
        entry = truth[frame["sequence"]]
        is_found = frame["outcome"] == Outcome.TARGET.value
        fully += entry.visible >= FULLY_VISIBLE
        found += is_found and entry.visible >= FULLY_VISIBLE
        unseen += entry.visible <= 0
        ghosts += is_found and entry.visible <= 0
        if is_found and entry.visible > 0:
            pose = pose_of(tuple(frame["camera_from_target"]))
            position_mm.append(1e3 * position_error_m(pose, entry.camera_from_target))
            normal_deg.append(np.degrees(normal_error_rad(pose, entry.camera_from_target)))
    return {
        "frames_fully_visible": fully,
        "found_of_these": found,
        "frames_without_target": unseen,
        "ghosts_in_these": ghosts,
        "position_error_mm": spread(position_mm),
        "normal_error_deg": spread(normal_deg),
    }
