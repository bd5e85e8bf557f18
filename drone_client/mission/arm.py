"""The compliant arm: a mass on a spring and a damper, pressed against a wall.

The paper's model of the unactuated arm, ``M_A a + D_A v + K_A d = -F_A``, along its own axis: ``d``
is how far the tip has been pushed in from where it is unloaded, ``F_A`` the force of the arm on
the board. Pure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from drone_client.bounds import check_bounds

_BOUNDS: dict[str, tuple[float, float]] = {
    "mass_kg": (0.005, 2.0),
    "damping_nspm": (0.1, 200.0),
    "stiffness_npm": (10.0, 10_000.0),
    "travel_m": (0.005, 0.2),
}


class Deflection(NamedTuple):
    """State of the arm along its axis."""

    d_m: float
    """Pushed in from where it is unloaded."""
    rate_mps: float


AT_REST = Deflection(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Arm:
    """Inertia, damping and elasticity of the arm along its axis, all seen at the tip.

    Raises:
        ValueError: a value is out of its bounds.
    """

    mass_kg: float = 0.15
    """M_A: what of the arm's mass moves with the tip."""
    damping_nspm: float = 12.0
    """D_A [N s/m]."""
    stiffness_npm: float = 300.0
    """K_A [N/m]."""
    travel_m: float = 0.04
    """How far it can give way before it is at its end."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)

    @property
    def natural_radps(self) -> float:
        """Frequency of the undamped arm, ``sqrt(K/M)``."""
        return math.sqrt(self.stiffness_npm / self.mass_kg)

    @property
    def damping_ratio(self) -> float:
        """``D / (2 sqrt(K M))``; from one on it does not swing."""
        return self.damping_nspm / (2.0 * math.sqrt(self.stiffness_npm * self.mass_kg))

    def settle_s(self, share: float = 0.05) -> float:
        """Time after which what is left of a deflection, let go at rest, is below a share of it.

        An upper bound, with ``s`` the slower mode: ``c exp(-s t)``, where ``c`` is what the other
        mode adds; near critical damping, where c grows without limit, ``(1 + s t) exp(-s t)``,
        which is below ``1.22 exp(-s t / 2)``.
        """
        w, z = self.natural_radps, self.damping_ratio
        root = math.sqrt(abs(1.0 - z * z))
        slow = w * z if z < 1.0 else w * (z - root)
        near_critical_s = 2.0 * math.log(1.22 / share) / slow
        if root < 0.01:
            return near_critical_s
        c = 1.0 / root if z < 1.0 else (z + root) / (2.0 * root)
        return min(math.log(c / share) / slow, near_critical_s)

    def static_force_n(self, depth_m: float) -> float:
        """Force on the board [N] of an arm at rest whose unloaded tip is ``depth_m`` behind it."""
        return self.stiffness_npm * min(max(depth_m, 0.0), self.travel_m)

    def static_depth_m(self, force_n: float) -> float:
        """How deep the unloaded tip is behind the board under a constant force."""
        return min(max(force_n, 0.0) / self.stiffness_npm, self.travel_m)

    def force_n(self, deflection: Deflection, acceleration_mps2: float = 0.0) -> float:
        """Force on the board [N] while the tip is on it; a board pushes and never pulls.

        Args:
            deflection: How far the tip is pushed in, and how fast.
            acceleration_mps2: Second derivative of the deflection.
        """
        return max(
            0.0,
            self.mass_kg * acceleration_mps2
            + self.damping_nspm * deflection.rate_mps
            + self.stiffness_npm * deflection.d_m,
        )

    def free(self, deflection: Deflection, base_mps2: float, dt_s: float) -> Deflection:
        """The deflection after a time without contact, in closed form.

        Args:
            deflection: Now.
            base_mps2: Acceleration of the arm's root towards the board, constant over the time: it
                pushes the tip in, ``M (d'' - base) + D d' + K d = 0``.
            dt_s: The time, at least zero.
        """
        w, z = self.natural_radps, self.damping_ratio
        rest = base_mps2 / (w * w)
        d, v, s = deflection.d_m - rest, deflection.rate_mps, w * z
        if z < 1.0:
            q = w * math.sqrt(1.0 - z * z)
            c, k = math.cos(q * dt_s), math.sin(q * dt_s) / q
            fade = math.exp(-s * dt_s)
        else:
            q = w * math.sqrt(z * z - 1.0)
            # cosh and sinh with the fading inside: neither overflows.
            up, down = math.exp((q - s) * dt_s), math.exp(-(q + s) * dt_s)
            c, k = 0.5 * (up + down), dt_s * math.exp(-s * dt_s)
            if q * dt_s > 1e-6:
                k = 0.5 * (up - down) / q
            fade = 1.0
        d_next = fade * (c * d + k * (v + s * d))
        v_next = fade * (c * v - k * (w * w * d + s * v))
        return Deflection(rest + d_next, v_next)

    def touched(self, deflection: Deflection, base: Base, dt_s: float) -> Deflection:
        """The deflection after a time in which there may be a board in front of the tip.

        The board is a stop: the tip moves as if free, and where that would carry it behind the
        plane, it stays in the plane and goes with the root.

        Args:
            deflection: Now.
            base: Where the unloaded tip will be when the time is over.
            dt_s: The time.
        """
        free = self.free(deflection, base.mps2, dt_s)
        if free.d_m >= base.depth_m:
            return free
        return Deflection(base.depth_m, base.mps)


class Base(NamedTuple):
    """Motion of the arm's root, as that of the unloaded tip."""

    depth_m: float
    """Of the unloaded tip behind the board's plane; negative in front of it."""
    mps: float
    """Towards the board."""
    mps2: float
    """Towards the board."""
