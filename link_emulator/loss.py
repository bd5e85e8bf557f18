"""Which packets are lost: each by itself, or in bursts."""

from __future__ import annotations

from random import Random
from typing import Protocol


class Loss(Protocol):
    """Decides about one packet after the other."""

    def lost(self) -> bool:
        """Whether the next packet is lost."""
        ...


class NoLoss:
    """Nothing is lost."""

    def lost(self) -> bool:
        """Never."""
        return False


class IndependentLoss:
    """Each packet is lost with the same probability, whatever became of the others."""

    def __init__(self, loss: float, rng: Random) -> None:
        self._loss = loss
        self._random = rng.random

    def lost(self) -> bool:
        """Whether the next packet is lost."""
        return self._random() < self._loss


class BurstLoss:
    """Gilbert's two states: in the good one nothing is lost, in the bad one everything.

    The state moves once a packet. A burst lasts 1/r packets, r the probability of leaving the bad
    state; with q that of entering it the mean loss is q/(q+r).

    Args:
        loss: mean share that is lost, between 0 and 1.
        burst: mean length of a burst in packets, at least 1.
        rng: where chance comes from.
    """

    def __init__(self, loss: float, burst: float, rng: Random) -> None:
        self._leave = 1 / burst
        self._enter = loss / (burst * (1 - loss))
        self._random = rng.random
        # A link that is met at any time: bad with the probability that it is bad on the whole
        self._bad = rng.random() < loss

    def lost(self) -> bool:
        """Whether the next packet is lost."""
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
