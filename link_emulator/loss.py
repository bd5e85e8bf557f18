"""Which packets are lost: each by itself, or in bursts."""

from __future__ import annotations

from random import Random
from typing import Protocol

PAUSE_NS = 10_000_000
"""Without a packet for so long, nothing is remembered: some 50 packet times at 50 Mbit/s."""


class Loss(Protocol):
    """Decides about one packet after the other."""

    def lost(self, now_ns: int) -> bool:
        """Whether the packet that comes now is lost."""
        ...


class NoLoss:
    """Nothing is lost."""

    def lost(self, now_ns: int) -> bool:
        """Never."""
        return False


class IndependentLoss:
    """Each packet is lost with the same probability, whatever became of the others."""

    def __init__(self, loss: float, rng: Random) -> None:
        self._loss = loss
        self._random = rng.random

    def lost(self, now_ns: int) -> bool:
        """Whether the packet that comes now is lost."""
        return self._random() < self._loss


class BurstLoss:
    """Gilbert's two states: in the good one nothing is lost, in the bad one everything.

    The state moves once a packet. A burst lasts 1/r packets, r the probability of leaving the bad
    state; with q that of entering it the mean loss is q/(q+r).

    A burst is a moment of the radio and not a debt in packets: after a pause the state is drawn
    anew. Otherwise a sender that waits after each loss, twice as long each time, would sit in one
    burst for half a minute, which no radio does.

    Args:
        loss: mean share that is lost, between 0 and 1.
        burst: mean length of a burst in packets, at least 1.
        rng: where chance comes from.
    """

    def __init__(self, loss: float, burst: float, rng: Random) -> None:
        self._leave = 1 / burst
        self._enter = loss / (burst * (1 - loss))
        self._random = rng.random
        self._loss = loss
        self._bad = False
        self._last_ns = -PAUSE_NS

    def lost(self, now_ns: int) -> bool:
        """Whether the packet that comes now is lost."""
        if now_ns - self._last_ns >= PAUSE_NS:
            # A link that is met at any time: bad with the probability that it is bad on the whole
            self._bad = self._random() < self._loss
        self._last_ns = now_ns
        bad = self._bad
        chance = self._leave if bad else self._enter
        if self._random() < chance:
            self._bad = not bad
        return bad


def make_loss(loss: float, burst: float | None, rng: Random) -> Loss:
    """The process for a mean loss and a mean burst length; None: independent."""
    if loss == 0:
        return NoLoss()
    if burst is None:
        return IndependentLoss(loss, rng)
    return BurstLoss(loss, burst, rng)
