"""The held command checked at the end of its period, not at its start alone (docs/cbf.md, 6)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from drone_client.cbf.variants import Barrier
from drone_client.cbf.vector import Vec3

HALVINGS = 6
"""Bound of the search; after it the straight retreat, which needs none."""
ROUNDING_M = 1e-9
"""Slack for the rounding of h, which is exact in theory where the tip moves along x."""


class Hold(NamedTuple):
    """The barrier over one control period in which the command is held."""

    barrier: Barrier
    p_target: Vec3
    """Tip now [m]."""
    delta_m: float
    """Error ball now [m]."""
    delta_next_m: float
    """Error ball when the period ends [m]."""
    alpha: float
    """Class-K gain [1/s]."""
    period_s: float
    """Length of the hold [s]; ``alpha period_s <= 1``."""

    @property
    def delta_rate_mps(self) -> float:
        """How fast the error ball grows over the period."""
        return (self.delta_next_m - self.delta_m) / self.period_s

    def h_next(self, u_target: Vec3) -> float:
        """Barrier at the end of the period for the tip velocity ``u_target`` [m/s]."""
        (x, y, z), (ux, uy, uz), t = self.p_target, u_target, self.period_s
        return self.barrier.h((x + t * ux, y + t * uy, z + t * uz), self.delta_next_m)

    def h_required(self, v_max: float) -> float:
        """What the barrier must be at the end of the period [m].

        ``(1 - alpha T) h``, or where that is out of reach as much as the straight retreat gives.
        """
        h_still = self.barrier.h(self.p_target, self.delta_next_m)
        return min(self.h_decayed(), h_still + self.period_s * v_max)

    def h_decayed(self) -> float:
        """``(1 - alpha T) h`` [m]."""
        h_now = self.barrier.h(self.p_target, self.delta_m)
        return (1.0 - self.alpha * self.period_s) * h_now

    def is_met(self, u_target: Vec3, v_max: float) -> bool:
        """Whether this tip velocity reaches what is required."""
        return self.h_next(u_target) >= self.h_required(v_max) - ROUNDING_M

    def retreat(self, v_max: float) -> Vec3:
        """The slowest velocity straight out along +x that meets ``h_required`` [m/s].

        Along x the barrier is linear with slope one, so this is exact, not a guess: zero wherever
        standing still is enough.
        """
        h_still = self.barrier.h(self.p_target, self.delta_next_m)
        needed = (self.h_required(v_max) - h_still) / self.period_s
        return min(max(needed, 0.0), v_max), 0.0, 0.0


def checked(
    u_target: Vec3, hold: Hold, v_max: float, kept_out: Callable[[Vec3], Vec3] | None = None
) -> tuple[Vec3, int]:
    """The tip velocity that still meets the barrier at the end of the period.

    Halves the distance to the straight retreat until it does, which is plain halving wherever
    standing still is safe. For ``h < 0`` plain halving would be wrong: it slows the recovery.

    Args:
        u_target: Tip velocity that the half-spaces allow [m/s].
        hold: The period.
        v_max: Speed limit [m/s].
        kept_out: What the planes that the body stays clear of make of the straight retreat; None:
            there are none. What lies between two velocities that they allow they allow too. Where
            the retreat is not enough any more, the best of what was tried is taken.

    Returns:
        The velocity and the number of halvings, ``HALVINGS`` meaning that none was enough.
    """
    best, most = u_target, hold.h_next(u_target)
    if most >= hold.h_decayed() - ROUNDING_M:  # nearly always, and never less than required
        return u_target, 0
    required = hold.h_required(v_max) - ROUNDING_M
    if most >= required:
        return u_target, 0
    retreat = hold.retreat(v_max)
    if kept_out is not None:
        retreat = kept_out(retreat)
    rx, ry, rz = retreat
    for halvings in range(1, HALVINGS):
        ux, uy, uz = u_target
        u_target = 0.5 * (ux + rx), 0.5 * (uy + ry), 0.5 * (uz + rz)
        h_next = hold.h_next(u_target)
        if h_next >= required:
            return u_target, halvings
        if h_next > most:
            best, most = u_target, h_next
    if kept_out is not None and hold.h_next(retreat) < most:
        return best, HALVINGS
    return retreat, HALVINGS
