"""The way of an answer in lockstep: what leaves first is sent first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from contact_sim.lockstep.link_model import Passage
from contact_sim.lockstep.worker import RESULT_BYTES
from link_emulator.profiles import PROFILES
from tests.unit.contact_sim.flights import lockstep_flight


class Sent(NamedTuple):
    size_bytes: int
    left_ns: int
    arrives_ns: int | None


def sent_down(link: str, seconds: float = 12.0) -> list[Sent]:
    """What the worker of a flight sends."""
    flight = lockstep_flight(0, PROFILES[link])
    found: list[Sent] = []
    send = flight.link.down.send

    def noted(size_bytes: int, now_ns: int) -> Passage:
        passage = send(size_bytes, now_ns)
        found.append(Sent(size_bytes, now_ns, passage.arrives_ns))
        return passage

    flight.link.down.send = noted  # type: ignore[method-assign]
    for _ in range(round(seconds / 0.02)):
        flight.tick()
    flight.close()
    return found


@pytest.mark.parametrize("link", ["wifi", "5g", "bad"])
def test_an_ack_does_not_wait_for_a_result_that_leaves_later(link: str) -> None:
    """The down link is given messages in the order in which they leave; both kinds are there."""
    sent = sent_down(link)
    times = [s.left_ns for s in sent]
    assert times == sorted(times)
    small = [s for s in sent if s.size_bytes < RESULT_BYTES]
    assert 0 < len(small) < len(sent)
    down = PROFILES[link].down
    took_ns = [s.arrives_ns - s.left_ns for s in small if s.arrives_ns is not None]
    assert np.max(took_ns) <= 1e6 * (2 * down.delay_ms + 2 * down.jitter_ms) + 20e6
