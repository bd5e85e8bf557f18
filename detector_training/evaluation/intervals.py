"""Confidence intervals of shares and rates: what so many pictures can say, and what they cannot."""

from __future__ import annotations

import math
from typing import NamedTuple

Z_95 = 1.959963984540054
"""Two-sided 95 % of a normal distribution."""


class Interval(NamedTuple):
    """A value and its 95 % confidence interval."""

    value: float
    low: float
    high: float


def wilson(hits: int, trials: int) -> Interval | None:
    """A share with Wilson's score interval, which holds near 0 and 1; None without trials.

    Raises:
        ValueError: there are more hits than trials.
    """
    if not 0 <= hits <= trials:
        raise ValueError(f"{hits} hits of {trials} trials")
    if not trials:
        return None
    p, z2 = hits / trials, Z_95**2
    middle = (p + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 / (1 + z2 / trials) * math.sqrt(p * (1 - p) / trials + z2 / (4 * trials**2))
    return Interval(p, max(0.0, min(p, middle - half)), min(1.0, max(p, middle + half)))


def upper_bound(events: int, pictures: int, confidence: float = 0.95) -> float:
    """One-sided bound on a Poisson rate per picture: with 0 events it is about 3 / ``pictures``.

    The exact (Garwood) bound: the rate at which as few events have probability 1 - confidence.

    Raises:
        ValueError: there are no pictures, or fewer than no events.
    """
    if events < 0 or pictures < 1:
        raise ValueError(f"{events} events in {pictures} pictures")
    low, high = float(events), events + 10 * math.sqrt(events + 1) + 10
    for _ in range(80):
        mean = (low + high) / 2
        if _poisson_at_most(events, mean) > 1 - confidence:
            low = mean
        else:
            high = mean
    return high / pictures


def _poisson_at_most(events: int, mean: float) -> float:
    """Probability of at most so many events, summed in logarithms: exp(-mean) may vanish."""
    if mean <= 0:
        return 1.0
    logs = [k * math.log(mean) - mean - math.lgamma(k + 1) for k in range(events + 1)]
    top = max(logs)
    return math.exp(top) * math.fsum(math.exp(x - top) for x in logs)
