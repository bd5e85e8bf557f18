"""Why results came too late to be used, where the service's own time explains it."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

from drone_client.gate import Verdict


def too_slow(
    frames: Sequence[dict[str, Any]], service_ms: dict[str, float] | None, *, shared: bool
) -> str | None:
    """The sentence; None: nothing was too old, or the service is not to blame for most of it.

    Args:
        frames: lines of the ledger.
        service_ms: what the service took for a picture.
        shared: the service runs on this machine, for this flight.
    """
    judged = [f for f in frames if f["fate"] == "answered"]
    old = [f for f in judged if f["verdict"] == Verdict.TOO_OLD.value]
    took = [f["service_ms"] for f in old]
    by_service = sum(f["service_ms"] > (f["network_delay_ms"] or 0.0) for f in old)
    if service_ms is None or not 2 * by_service > len(old):
        return None
    why = (
        "this machine is too slow for both, or busy; with --age-max-ms 500 the drone flies by "
        "older poses, and keeps more room"
        if shared
        else "it is too slow, or busy"
    )
    return (
        f"{len(old)} of {len(judged)} results were too old: the service took {median(took):.0f} ms "
        f"for such a picture, where 95 % of all took at most {service_ms['p95']:.0f} ms; {why}"
    )
