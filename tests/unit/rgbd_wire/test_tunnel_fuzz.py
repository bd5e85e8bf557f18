"""A short run of the tunnel's fuzzer; ``tests/perf/fuzz_tunnel.py`` is the long one."""

from __future__ import annotations

from tests.perf.fuzz_tunnel import fuzz


def test_mutants_are_taken_in_or_counted() -> None:
    """Twenty thousand datagrams: never an exception, bounded memory, every layer reached."""
    outcome = fuzz(20_000, seed=7)
    reached = {"not_authentic", "replayed", "bad_shard", "evicted", "stale", "bad_mac", "message"}
    assert all(outcome.counts[name] > 10 for name in reached)
