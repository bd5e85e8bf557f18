"""A short run of the tunnel's fuzzer; ``scripts/fuzz datagrams`` is the long one."""

from __future__ import annotations

from tests.perf.fuzz_run import HANG_S, Plan, Report, run_block
from tests.perf.fuzz_tunnel import TunnelBlock, fuzz

LAYERS = {"not_authentic", "replayed", "bad_shard", "evicted", "stale", "bad_mac", "message"}


def test_mutants_are_taken_in_or_counted() -> None:
    """Twenty thousand datagrams: never an exception, every bound holds, every layer reached."""
    outcomes = fuzz(20_000, seed=7)
    made = {"signed HELLO", "signed WELCOME", "bad_cookie"}
    assert all(outcomes[name] > 10 for name in LAYERS | made)


def test_a_find_is_told_and_can_be_repeated() -> None:
    """A panic of a library, which is no ``Exception``, ends the block and names it."""

    class Panic(BaseException):
        pass

    class Bad(TunnelBlock):
        def throw(self) -> int:
            if self.thrown > 10:
                raise Panic("in Rust")
            return super().throw()

    report = Report()
    assert not run_block(Plan(Bad, 100, 1000, seed=3), 4, report, lambda thrown: None)
    assert report.find.startswith("block 4 of seed 3")
    assert "in Rust" in report.find
    assert report.thrown > 10
    assert report.slowest_s < HANG_S
