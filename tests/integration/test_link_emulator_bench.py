"""`scripts/bench link` runs: every contender carries frames over the emulated link."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from link_emulator import may_make_namespaces
from tests.perf.bench_link import CONTENDERS, ROUND_TRIPS

WHY_NOT = may_make_namespaces()


@pytest.mark.skipif(WHY_NOT is not None, reason=str(WHY_NOT))
def test_every_contender_delivers_on_a_clean_link() -> None:
    """All six, and the three of the round trip; none is faster than light."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.perf.bench_link"]
        + ["--quick", "--seconds", "0.5", "--only", "B0,D", "--json"],
        check=True,
        stdout=subprocess.PIPE,
        timeout=200,
    )
    told = json.loads(done.stdout)
    assert [run["contender"] for run in told["runs"]] == [c.name for c in CONTENDERS]
    for run in told["runs"]:
        assert run["delivered"] > 0.5
        assert run["age_ms"]["p50"] > 10 + 60_000 * 8e-3 / 50  # delay and serialisation
        assert run["sent"] >= run["delivered"]
    assert list(told["round_trips_ms"]) == list(ROUND_TRIPS)
    assert all(times for (times,) in told["round_trips_ms"].values())
