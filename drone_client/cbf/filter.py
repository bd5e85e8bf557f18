"""The safety filter: a wanted tip velocity in, a safe body velocity out, and why (docs/cbf.md).

Pure, without a dependency, without a clock, and without an exception: whatever the numbers are,
there is a command within the limits and a status.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drone_client.cbf.error_ball import error_ball_m
from drone_client.cbf.freshness import Freshness, freshness
from drone_client.cbf.half_space import HalfSpace, build
from drone_client.cbf.limits import alpha, closing_limit_mps
from drone_client.cbf.next_step import Hold, checked
from drone_client.cbf.settings import FilterSettings
from drone_client.cbf.solve import solve
from drone_client.cbf.status import Status
from drone_client.cbf.variants import Variant
from drone_client.cbf.vector import ZERO, Vec3, cross, is_bounded, moved, norm

FARTHEST = 1e3
"""A position [m], velocity [m/s] or rate [rad/s] beyond this is a fault, not a state."""
UNIT_TOLERANCE = 0.01
"""How far from one the length of the up axis may be."""


@dataclass(frozen=True, slots=True)
class FilterInput:
    """What the filter needs to know at one control tick; all vectors in frame ``target``."""

    tip_target: Vec3
    """Estimated position of the unloaded tip [m]."""
    velocity_tip_nominal_target: Vec3
    """Wanted velocity of the tip [m/s]."""
    yaw_rate_nominal_radps: float
    """Wanted yaw rate, positive about ``up_target``."""
    lever_arm_target: Vec3
    """From the body's origin to the tip [m]."""
    up_target: Vec3
    """The world's up, unit length."""
    age_ns: int
    """Age of the measurement behind ``tip_target`` now, on the drone's clock."""
    range_m: float
    """Distance from the camera to the target when that measurement was made."""
    sigma_m: float
    """Standard deviation of that measurement along its worst direction."""
    unconfirmed_ns: int = 0
    """How long nobody but the drone itself has seen the target; 0: the edge measured."""


@dataclass(frozen=True, slots=True)
class SafeCommand:
    """What to fly until the next tick."""

    velocity_body_target: Vec3
    """Velocity of the body's origin in frame ``target`` [m/s], at most ``v_max_mps`` long."""
    yaw_rate_radps: float
    """Positive about the world's up."""
    h: float
    """Barrier at the estimated tip [m]; NaN where the input is no number."""
    h_robust: float
    """Barrier that the true tip has at least [m]; NaN where the input is no number."""
    status: Status
    """What the filter did."""
    freshness: Freshness
    """The phase that the age of the measurement puts the drone in."""
    delta_m: float
    """Radius of the error ball [m]; NaN where the input is no number."""


def filter_command(inp: FilterInput, settings: FilterSettings) -> SafeCommand:
    """The safe command nearest to the wanted one.

    The order is the order of trust: no numbers, no motion; a tip where none may be backs off;
    old knowledge allows no approach; and only then does the funnel have its say.
    """
    phase = freshness(inp.age_ns, settings)
    if not _is_usable(inp):
        return SafeCommand(ZERO, 0.0, math.nan, math.nan, Status.ABORT, phase, math.nan)
    barrier, p = settings.barrier, inp.tip_target
    # Two sizes of the ball, not one and a rate: within the period the age may pass age_max_ns.
    period_ns, alone_ns = round(settings.period_s * 1e9), inp.unconfirmed_ns
    alone_next_ns = alone_ns + period_ns if alone_ns else 0
    age_next_ns = inp.age_ns + period_ns
    delta = error_ball_m(inp.age_ns, inp.range_m, inp.sigma_m, settings, alone_ns)
    delta_next = error_ball_m(age_next_ns, inp.range_m, inp.sigma_m, settings, alone_next_ns)
    hold = Hold(barrier, p, delta, delta_next, alpha(p, settings), settings.period_s)
    h = barrier.h(p)

    yaw_rate = 0.0
    if p[0] < -settings.depth_max_m or (p[0] < 0.0 and h < 0.0):
        tip_velocity, status = _back_off(p, settings), Status.ABORT
    elif phase is Freshness.RETREAT:
        tip_velocity, status = _back_off(p, settings), Status.STALE
    elif phase is Freshness.BRAKE:
        tip_velocity, status = hold.retreat(_blind_limit_mps(settings)), Status.STALE
    else:
        tip_velocity, yaw_rate, status = _through_the_funnel(inp, hold, phase, settings)

    velocity_body = moved(tip_velocity, _swing_arm(inp), -yaw_rate)
    h_robust = barrier.h(p, delta)
    return SafeCommand(velocity_body, yaw_rate, h, h_robust, status, phase, delta)


def _through_the_funnel(
    inp: FilterInput, hold: Hold, phase: Freshness, settings: FilterSettings
) -> tuple[Vec3, float, Status]:
    """Tip velocity, yaw rate and status while the target is known well enough to move by it."""
    delta_rate = (hold.delta_next_m - hold.delta_m) / hold.period_s
    half_space = build(hold.barrier, hold.p_target, hold.delta_m, delta_rate, hold.alpha)
    yaw_rate = _yaw_rate(inp, half_space, settings)
    # The body undoes the swing of the tip; what is left of its speed is the tip's.
    v_max = settings.v_max_mps - abs(yaw_rate) * norm(_swing_arm(inp))
    nominal = _slowed(inp.velocity_tip_nominal_target, hold, phase, settings)
    tip_velocity, status = solve(nominal, half_space, v_max)
    if settings.variant is Variant.SMOOTH:  # the others are shown as the paper has them
        tip_velocity, halvings = checked(tip_velocity, hold, v_max)
        if halvings and status is Status.INACTIVE:
            status = Status.ACTIVE
    return tip_velocity, yaw_rate, status if phase is Freshness.FRESH else Status.STALE


def _slowed(nominal: Vec3, hold: Hold, phase: Freshness, settings: FilterSettings) -> Vec3:
    """The nominal velocity with its approach limited, and none of it where knowledge is old.

    Everything after this adds a positive multiple of the gradient, whose x component is one, or
    shortens: the limit holds for the result too (docs/cbf.md, section 7).
    """
    limit = 0.0
    if phase is Freshness.FRESH:
        nearest = hold.p_target[0] - hold.delta_m
        limit = closing_limit_mps(
            nearest, settings.touch_mps, settings.brake_mps2, settings.depth_max_m
        )
    return max(nominal[0], -limit), nominal[1], nominal[2]


def _yaw_rate(inp: FilterInput, half_space: HalfSpace, settings: FilterSettings) -> float:
    """The yaw rate [rad/s] that leaves the tip the speed which the funnel asks of it."""
    v_max, arm = settings.v_max_mps, norm(_swing_arm(inp))
    needed = half_space.offset / norm(half_space.normal)
    swing = max(0.0, min(settings.yaw_speed_share * v_max, v_max - needed))
    limit = settings.yaw_rate_max_radps
    if arm * limit > swing:
        limit = swing / arm
    return min(max(inp.yaw_rate_nominal_radps, -limit), limit)


def _swing_arm(inp: FilterInput) -> Vec3:
    """Velocity of the tip per unit of yaw rate, ``up x r`` [m]."""
    return cross(inp.up_target, inp.lever_arm_target)


def _blind_limit_mps(settings: FilterSettings) -> float:
    return min(settings.retreat_mps, settings.v_max_mps)


def _back_off(p_target: Vec3, settings: FilterSettings) -> Vec3:
    """Straight away from the board, ending at the stand-off distance."""
    left = max(0.0, settings.standoff_m - p_target[0])
    return min(_blind_limit_mps(settings), left / settings.period_s), 0.0, 0.0


def _is_usable(inp: FilterInput) -> bool:
    """Whether every input is a number that a drone can have."""
    return (
        is_bounded(inp.tip_target, FARTHEST)
        and is_bounded(inp.velocity_tip_nominal_target, FARTHEST)
        and is_bounded(inp.lever_arm_target, FARTHEST)
        and is_bounded(inp.up_target, 1.0 + UNIT_TOLERANCE)
        and abs(norm(inp.up_target) - 1.0) <= UNIT_TOLERANCE
        and -FARTHEST <= inp.yaw_rate_nominal_radps <= FARTHEST
        and 0.0 <= inp.range_m <= FARTHEST
        and 0.0 <= inp.sigma_m <= FARTHEST
    )
