"""Why a flight was aborted on a machine that is too slow: said where it is so, and only there."""

from __future__ import annotations

from typing import Any

import pytest

from drone_client.fly.lateness import too_slow

TOOK = {"p50": 70.0, "p95": 212.4, "p99": 300.0, "max": 310.0}


def answered(verdict: str, service_ms: float, network_ms: float | None = 20.0) -> dict[str, Any]:
    return {
        "fate": "answered",
        "verdict": verdict,
        "service_ms": service_ms,
        "network_delay_ms": network_ms,
    }


GOOD = [answered("accepted", 70.0)] * 6
LATE_BY_SERVICE = [answered("too_old", 290.0)] * 3
LATE_BY_NETWORK = [answered("too_old", 40.0, 260.0)] * 3


@pytest.mark.parametrize(
    ("shared", "why"),
    [
        (
            True,
            "this machine is too slow for both, or busy; with --age-max-ms 500 the drone flies by "
            "older poses, and keeps more room",
        ),
        (False, "it is too slow, or busy"),
    ],
)
def test_a_slow_service_is_named(shared: bool, why: str):
    """With how many, of how many, and how long it took; a frame nobody answered is no result."""
    frames = [*GOOD, *LATE_BY_SERVICE, {"fate": "no_reply"}]
    assert too_slow(frames, TOOK, shared=shared) == (
        "3 of 9 results were too old: the service took 290 ms for such a picture, where 95 % of "
        f"all took at most 212 ms; {why}"
    )


@pytest.mark.parametrize(
    ("frames", "took"),
    [
        (GOOD, TOOK),
        ([*GOOD, *LATE_BY_NETWORK, *LATE_BY_SERVICE], TOOK),
        ([], None),
    ],
)
def test_where_it_is_not_the_service_nothing_is_said(frames: list[dict[str, Any]], took: Any):
    """None too old, or most of them late by the link."""
    assert too_slow(frames, took, shared=True) is None
