"""What the barrier asks of the tip's velocity now: one half-space (docs/cbf.md, section 4)."""

from __future__ import annotations

from typing import NamedTuple

from drone_client.cbf.variants import Barrier
from drone_client.cbf.vector import Vec3


class HalfSpace(NamedTuple):
    """The velocities ``u`` with ``normal . u >= offset``."""

    normal: Vec3
    """Gradient of the barrier; any length."""
    offset: float
    """[m/s] times the length of the normal."""


def build(
    barrier: Barrier, p_target: Vec3, delta_m: float, delta_rate_mps: float, alpha: float
) -> HalfSpace:
    """The velocities that keep ``dh/dt >= -alpha h`` while the error ball grows.

    Args:
        barrier: The safe set.
        p_target: Tip in frame ``target`` [m].
        delta_m: Radius of the error ball [m].
        delta_rate_mps: How fast that radius grows [m/s].
        alpha: Gain of the class-K function ``alpha h`` [1/s].

    Returns:
        ``grad h . u >= -alpha h - (dh/ddelta) (ddelta/dt)``, for tip velocities in frame
        ``target``.
    """
    h = barrier.h(p_target, delta_m)
    drift = barrier.dh_ddelta(p_target, delta_m) * delta_rate_mps
    return HalfSpace(barrier.gradient(p_target, delta_m), -alpha * h - drift)
