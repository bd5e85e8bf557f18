"""The safety filter: a wanted tip velocity in, a safe body velocity out, and why (docs/cbf.md).

Pure, without a dependency, without a clock, and without an exception: whatever the numbers are,
there is a command within the limits and a status.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from drone_client.cbf.error_ball import error_ball_m
from drone_client.cbf.freshness import Freshness, freshness
from drone_client.cbf.half_space import HalfSpace, build
from drone_client.cbf.keep_out import (
    LEVEL,
    MAX_KEEP_OUTS,
    KeepOut,
    Rotation,
    Stance,
    half_spaces,
    is_rotation,
)
from drone_client.cbf.limits import alpha, closing_limit_mps, limit_outside_mps
from drone_client.cbf.next_step import Hold, checked
from drone_client.cbf.settings import FilterSettings
from drone_client.cbf.solve import Solution, solve
from drone_client.cbf.solve_several import solve_several
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
    keep_outs: tuple[KeepOut, ...] = ()
    """Planes that the body stays clear of, at most ``MAX_KEEP_OUTS``."""
    target_from_body: Rotation = LEVEL
    """Rows of the body's rotation: where its parts are. Counts with ``keep_outs`` alone."""
    target_from_world: Rotation = LEVEL
    """Rows of the rotation that takes the world's planes to the target's frame; likewise."""
    world_origin_target: Vec3 = ZERO
    """Origin of the world [m]; likewise."""


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
    h, h_robust = barrier.h(p), barrier.h(p, delta)
    swing_arm = cross(inp.up_target, inp.lever_arm_target)
    tick = _Tick(inp, settings, phase, hold, swing_arm, h_robust)

    yaw_rate = 0.0
    if p[0] < -settings.depth_max_m or (p[0] < 0.0 and h < 0.0):
        tip_velocity, status = _straight(_back_off(p, settings), tick), Status.ABORT
    elif phase is Freshness.RETREAT:
        tip_velocity, status = _straight(_back_off(p, settings), tick), Status.STALE
    elif phase is Freshness.BRAKE:
        retreat = hold.retreat(_blind_limit_mps(settings))
        tip_velocity, status = _straight(retreat, tick), Status.STALE
    else:
        tip_velocity, yaw_rate, status = _through_the_funnel(tick)

    velocity_body = moved(tip_velocity, tick.swing_arm, -yaw_rate)
    return SafeCommand(velocity_body, yaw_rate, h, h_robust, status, phase, delta)


class _Tick(NamedTuple):
    """What the steps of one tick share."""

    inp: FilterInput
    settings: FilterSettings
    phase: Freshness
    hold: Hold
    swing_arm: Vec3
    """Velocity of the tip per unit of yaw rate, ``up x r`` [m]."""
    h_robust: float
    """Barrier that the true tip has at least [m]."""


def _straight(retreat: Vec3, tick: _Tick) -> Vec3:
    """A way straight out as far as the keep-outs let it go, without turning.

    A body against a second wall is a crash; a tip that waits before the board is not. So the
    keep-outs have the first word, and no approach the second.
    """
    if not tick.inp.keep_outs:
        return retreat
    limit = _blind_limit_mps(tick.settings)
    return solve_several(retreat, _keep_outs(tick, 0.0), (_closing(0.0),), limit).u


def _through_the_funnel(tick: _Tick) -> tuple[Vec3, float, Status]:
    """Tip velocity, yaw rate and status while the target is known well enough to move by it."""
    hold = tick.hold
    funnel = build(hold.barrier, hold.p_target, hold.delta_m, hold.delta_rate_mps, hold.alpha)
    yaw_rate = _yaw_rate(funnel, tick)
    tip_velocity, status = _at_yaw_rate(yaw_rate, funnel, tick)
    if tick.inp.keep_outs and yaw_rate and status is Status.MAX_HDOT:
        # It may be the turn that swings a propeller at a wall: the drone does not turn there.
        yaw_rate = 0.0
        tip_velocity, status = _at_yaw_rate(yaw_rate, funnel, tick)
    return tip_velocity, yaw_rate, status if tick.phase is Freshness.FRESH else Status.STALE


def _at_yaw_rate(yaw_rate: float, funnel: HalfSpace, tick: _Tick) -> Solution:
    """Tip velocity and status at this yaw rate."""
    inp, settings, hold = tick.inp, tick.settings, tick.hold
    # The body undoes the swing of the tip; what is left of its speed is the tip's.
    v_max = settings.v_max_mps - abs(yaw_rate) * norm(tick.swing_arm)
    limit = _closing_limit_mps(tick)
    nominal = _slowed(inp.velocity_tip_nominal_target, limit)
    kept_out = None
    if inp.keep_outs:
        # Backing off is a wish: there may be a second wall behind the drone
        planes, closing = _keep_outs(tick, yaw_rate), _closing(max(limit, 0.0))
        tip_velocity, status = solve_several(nominal, planes, (closing, funnel), v_max)

        def kept_out(retreat: Vec3) -> Vec3:
            return solve_several(retreat, planes, (closing,), v_max).u

    else:
        tip_velocity, status = solve(nominal, funnel, v_max)
    if settings.variant is Variant.SMOOTH:  # the others are shown as the paper has them
        tip_velocity, halvings = checked(tip_velocity, hold, v_max, kept_out)
        if halvings and status is Status.INACTIVE:
            status = Status.ACTIVE
        if halvings and kept_out is not None and not hold.is_met(tip_velocity, v_max):
            status = Status.MAX_HDOT
    return Solution(tip_velocity, status)


def _keep_outs(tick: _Tick, yaw_rate: float) -> list[HalfSpace]:
    """What the planes ask of the tip's velocity at this yaw rate."""
    inp, hold = tick.inp, tick.hold
    stance = Stance(
        inp.tip_target,
        inp.lever_arm_target,
        inp.up_target,
        inp.target_from_body,
        inp.target_from_world,
        inp.world_origin_target,
    )
    return half_spaces(
        inp.keep_outs, stance, hold.delta_m, hold.delta_rate_mps, yaw_rate, hold.period_s
    )


def _closing(limit_mps: float) -> HalfSpace:
    """The velocities that close in on the board no faster than this.

    Beside keep-outs it must be said: a plane behind the drone pushes towards the board.
    """
    return HalfSpace((1.0, 0.0, 0.0), -limit_mps)


def _closing_limit_mps(tick: _Tick) -> float:
    """How fast the tip may close in now [m/s]: not on old knowledge, nor outside the funnel."""
    if tick.phase is not Freshness.FRESH:
        return 0.0
    hold, settings = tick.hold, tick.settings
    nearest = hold.p_target[0] - hold.delta_m
    limit = closing_limit_mps(
        nearest,
        settings.touch_mps,
        settings.brake_mps2,
        settings.depth_max_m,
        settings.command_lag_s,
    )
    if settings.variant is not Variant.SMOOTH:  # shown as the paper has it
        return limit
    return limit_outside_mps(limit, nearest, tick.h_robust, settings)


def _slowed(nominal: Vec3, limit_mps: float) -> Vec3:
    """The nominal velocity with its approach limited.

    Everything after this adds a positive multiple of the gradient, whose x component is one, or
    shortens: the limit holds for the result too (docs/cbf.md, section 7).
    """
    return max(nominal[0], -limit_mps), nominal[1], nominal[2]


def _yaw_rate(funnel: HalfSpace, tick: _Tick) -> float:
    """The yaw rate [rad/s] that leaves the tip the speed which the funnel asks of it."""
    settings = tick.settings
    v_max, arm = settings.v_max_mps, norm(tick.swing_arm)
    needed = funnel.offset / norm(funnel.normal)
    swing = max(0.0, min(settings.yaw_speed_share * v_max, v_max - needed))
    limit = settings.yaw_rate_max_radps
    if arm * limit > swing:
        limit = swing / arm
    return min(max(tick.inp.yaw_rate_nominal_radps, -limit), limit)


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
        and (not inp.keep_outs or _is_placed(inp))
    )


def _is_placed(inp: FilterInput) -> bool:
    """Whether it can be said where the body's parts and the planes are."""
    return (
        len(inp.keep_outs) <= MAX_KEEP_OUTS
        and is_rotation(inp.target_from_body, UNIT_TOLERANCE)
        and is_rotation(inp.target_from_world, UNIT_TOLERANCE)
        and is_bounded(inp.world_origin_target, FARTHEST)
    )
