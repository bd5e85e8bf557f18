"""A link in lockstep: what a profile's numbers do to messages."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.chance import stream
from contact_sim.lockstep.link_model import LinkModel, Way
from link_emulator.impairments import Impairments
from link_emulator.profiles import PROFILES

MS = 1_000_000


def test_delay_and_rate_add_up() -> None:
    """50 kB at 40 Mbit/s take 10 ms; a second message waits for the first."""
    way = Way(Impairments(rate_mbit=40.0, delay_ms=3.0), stream(0, "way"))
    assert way.send(50_000, 0).arrives_ns == 13 * MS
    assert way.send(50_000, 0).arrives_ns == 23 * MS
    assert way.send(50_000, 100 * MS).arrives_ns == 113 * MS


def test_a_queue_that_is_full_drops() -> None:
    """100 ms of queue: what would wait longer is lost, and takes no time of the link."""
    way = Way(Impairments(rate_mbit=1.0, queue_ms=100.0), stream(0, "way"))
    assert way.send(12_500, 0).arrives_ns == 100 * MS
    assert way.send(12_500, 0).arrives_ns == 200 * MS
    assert way.send(12_500, 0).arrives_ns is None
    assert way.send(12_500, 150 * MS).arrives_ns == 300 * MS


@given(st.integers(0, 2**32), st.sampled_from(sorted(PROFILES)))
def test_nothing_overtakes_and_the_seed_says_it_all(seed: int, name: str) -> None:
    """Arrivals are in the order of sending; the same seed gives the same ones."""

    def arrivals() -> list[int | None]:
        link = LinkModel(PROFILES[name], stream(seed, "link"))
        return [link.up.send(60_000, i * 66 * MS).arrives_ns for i in range(30)]

    first = arrivals()
    there = [a for a in first if a is not None]
    assert there == sorted(there)
    assert all(a >= i * 66 * MS for i, a in enumerate(first) if a is not None)
    assert arrivals() == first


@pytest.mark.parametrize("burst", [None, 4.0])
def test_as_many_packets_are_lost_as_the_profile_says(burst: float | None) -> None:
    """One packet a message, which nothing can make up for: the share of the profile."""
    way = Way(Impairments(loss=0.05, burst=burst), stream(1, "way"))
    lost = np.mean([way.send(100, i * MS).arrives_ns is None for i in range(20_000)])
    # Of a burst that is longer than the message only its own packet counts
    expected = 0.05 / (burst or 1.0)
    assert lost == pytest.approx(expected, rel=0.15)


def test_a_cut_passes_nothing_and_draws_the_same_chances() -> None:
    """After it the link is the one that it would have been."""
    cut, whole = (LinkModel(PROFILES["wifi"], stream(3, "link")) for _ in range(2))
    cut.cut(cut=True)
    for i in range(10):
        whole.up.send(1000, i * 100 * MS)
        assert cut.up.send(1000, i * 100 * MS).arrives_ns is None
    cut.cut(cut=False)
    assert cut.up.send(1000, 5000 * MS) == whole.up.send(1000, 5000 * MS)
