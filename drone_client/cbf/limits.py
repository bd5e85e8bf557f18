"""How fast the tip may close in, by its place and by h, and how soon h may be used up."""

from __future__ import annotations

import math

from drone_client.cbf.settings import FilterSettings
from drone_client.cbf.vector import Vec3, norm


def closing_limit_mps(
    x_m: float, touch_mps: float, brake_mps2: float, depth_m: float, lag_s: float = 0.0
) -> float:
    """Largest commanded speed towards the board [m/s] at the distance ``x_m`` from it [m].

    In front of the board, the speed from which braking at ``brake_mps2`` leaves ``touch_mps`` at
    the touch (``v^2 = v_0^2 + 2 a x``), less what a vehicle that follows its command ``lag_s``
    late has not braked yet (``a lag``): it is then itself no faster than that profile. Behind the
    board, linear down to zero at ``depth_m``, which makes ``x >= -depth_m`` a set that the tip
    cannot leave (docs/cbf.md, section 7).
    """
    late_mps = brake_mps2 * lag_s
    if x_m >= 0.0:
        return max(0.0, math.sqrt(touch_mps * touch_mps + 2.0 * brake_mps2 * x_m) - late_mps)
    return max(0.0, touch_mps - late_mps) * max(0.0, 1.0 + x_m / depth_m)


def limit_outside_mps(
    limit_mps: float, nearest_m: float, h_robust_m: float, settings: FilterSettings
) -> float:
    """The closing limit [m/s] for a tip that may be outside the funnel; negative: it backs off.

    The barrier alone asks of a tip outside that h grows, and lets a sideways way back pay for an
    approach. Near the board the board comes first: ``outside_m`` below zero the tip does not go
    on, and as much again, within ``clear_m`` of the board, it backs off at ``retreat_mps``.

    Args:
        limit_mps: of a tip inside, at least zero.
        nearest_m: distance from the board that the tip has at least.
        h_robust_m: barrier that it has at least.
        settings: of the filter.
    """
    share = min(max(1.0 + h_robust_m / settings.outside_m, -1.0), 1.0)
    if share >= 0.0:
        return share * limit_mps
    near = min(max(1.0 - nearest_m / settings.clear_m, 0.0), 1.0)
    return share * near * min(settings.retreat_mps, settings.v_max_mps)


def alpha(p_target: Vec3, settings: FilterSettings) -> float:
    """Class-K gain [1/s] at the tip ``p_target`` [m]: small near the target, larger far from it.

    ``alpha_near`` up to ``near_m`` from the target, ``alpha_far`` from ``far_m`` on, a smoothstep
    between them.
    """
    s = (norm(p_target) - settings.near_m) / (settings.far_m - settings.near_m)
    s = min(max(s, 0.0), 1.0)
    blend = s * s * (3.0 - 2.0 * s)
    return settings.alpha_near + (settings.alpha_far - settings.alpha_near) * blend
