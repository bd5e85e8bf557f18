"""Loss has the mean and the burst length that it was asked for."""

from __future__ import annotations

from itertools import groupby
from random import Random

import pytest

from link_emulator.loss import PAUSE_NS, make_loss

PACKETS = 200_000


def lost(loss: float, burst: float | None, seed: int = 5, gap_ns: int = PAUSE_NS - 1) -> list[bool]:
    """What became of many packets, one each so many ns."""
    process = make_loss(loss, burst, Random(seed))
    return [process.lost(n * gap_ns) for n in range(PACKETS)]


def bursts(outcome: list[bool]) -> list[int]:
    """Lengths of the runs of lost packets."""
    return [len(list(run)) for is_lost, run in groupby(outcome) if is_lost]


@pytest.mark.parametrize("loss", [0.01, 0.1, 0.5])
def test_independent_loss_has_its_mean_and_no_memory(loss: float) -> None:
    """The share is right, and after a lost packet the next is lost as often as any other."""
    outcome = lost(loss, None)
    after_lost = [b for a, b in zip(outcome, outcome[1:], strict=False) if a]
    assert sum(outcome) / PACKETS == pytest.approx(loss, rel=0.06)
    assert sum(after_lost) / len(after_lost) == pytest.approx(loss, rel=0.25)


@pytest.mark.parametrize(("loss", "burst"), [(0.03, 4), (0.01, 10), (0.3, 2), (0.5, 1)])
def test_burst_loss_has_its_mean_and_its_burst_length(loss: float, burst: float) -> None:
    """Both within what so many packets can tell."""
    outcome = lost(loss, burst)
    lengths = bursts(outcome)
    assert sum(outcome) / PACKETS == pytest.approx(loss, rel=0.15)
    assert sum(lengths) / len(lengths) == pytest.approx(burst, rel=0.1)


def test_burst_is_over_after_a_pause() -> None:
    """Whoever waits after a loss finds the link as anybody would: bad as often as on the whole."""
    outcome = lost(0.1, 50, gap_ns=PAUSE_NS)
    after_lost = [b for a, b in zip(outcome, outcome[1:], strict=False) if a]
    assert sum(outcome) / PACKETS == pytest.approx(0.1, rel=0.1)
    assert sum(after_lost) / len(after_lost) == pytest.approx(0.1, rel=0.1)


def test_no_loss_and_total_loss() -> None:
    """The two ends of the scale are exact."""
    assert not any(lost(0, None))
    assert all(lost(1, None))
