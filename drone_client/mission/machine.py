"""The mission as a function: state and observation in, state and intent out (docs/mission.md).

Pure: no clock, no I/O, and no observation makes it raise. At most one transition a tick, and the
order in which they are looked for is the order of trust: what ends the mission, what stops it, what
halts it, and only then the way on.
"""

from __future__ import annotations

import math
from dataclasses import replace

from drone_client.cbf.vector import is_bounded, moved, norm
from drone_client.guidance import STILL, Aim, Goal
from drone_client.mission.contact import FARTHEST, ContactState, Feeling, feel
from drone_client.mission.ends import end, taken_away
from drone_client.mission.interrupts import interrupt
from drone_client.mission.move import (
    NS_PER_S,
    Move,
    clock_stands,
    is_good,
    lasts,
    phase_lasts,
    since,
    trusted,
)
from drone_client.mission.phase import Order, Phase, Reason
from drone_client.mission.settings import MissionSettings
from drone_client.mission.state import Intent, MissionState, Observation, Seen, Transition
from drone_client.mission.ways import way_on

LAST_NS = 2**63 - 1
"""Clocks end here; what comes later is this."""
FASTEST_MPS = 1.0
"""Between two ticks a tip moves no faster: more than twice the filter's limit."""
LATE_S = 0.2
"""Over a longer pause between two ticks nobody can tell a leap from a flight: it is a leap."""
HEADING_MAX_RAD = 1e3
UNFELT = ContactState()


def begin(now_ns: int) -> MissionState:
    """A new mission: it waits for the vehicle. Also the only way out of DONE and ABORT."""
    now_ns = min(max(now_ns, 0), LAST_NS)
    return MissionState(Phase.HOLD, Reason.WAITING, now_ns, now_ns)


def step(
    state: MissionState, observation: Observation, settings: MissionSettings
) -> tuple[MissionState, Intent]:
    """One tick.

    Args:
        state: Of the tick before, with what the filter answered in ``told``.
        observation: What there is to see.
        settings: The mission's numbers.

    Returns:
        The state now, whose ``transition`` says what happened and why, and what to fly.
    """
    obs = _sane(observation)
    state = _looked(state, obs, settings)
    move = None if state.phase.final else _next(state, obs, settings)
    if move is not None:
        state = _entered(state, move, obs, settings)
    intent = _intent(state, obs, settings)
    if state.given_back is not intent.give_back:
        state = replace(state, given_back=intent.give_back)
    return state, intent


def _next(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    return (
        end(state, obs, settings) or interrupt(state, obs, settings) or way_on(state, obs, settings)
    )


def _sane(obs: Observation) -> Observation:
    """A place that is no number is no place."""
    seen = obs.seen
    if seen is None:
        return obs
    usable = (
        obs.own_pose
        and is_bounded(seen.tip_target, FARTHEST)
        and is_bounded(seen.tip_world, 1e3 * FARTHEST)
        and is_bounded(seen.axis_world, 1.01)
    )
    return obs if usable else replace(obs, seen=None)


def _looked(state: MissionState, obs: Observation, settings: MissionSettings) -> MissionState:
    """The state with what this tick shows, before anything is decided."""
    now_ns = min(max(state.now_ns, obs.now_ns), LAST_NS)
    passed_ns = now_ns - state.now_ns
    # A person thinks: nobody waits for a vehicle yet
    thinks = state.begun_ns is None and obs.senses.order is Order.HOLD
    lost = obs.senses.odometry_jumped or not obs.own_pose
    state = replace(
        state,
        now_ns=now_ns,
        stood=0 if passed_ns else min(state.stood + 1, 10**6),
        transition=None,
        since_ns=now_ns if thinks else state.since_ns,
        lost_ns=now_ns if lost else state.lost_ns,
    )
    seen = trusted(state, obs)
    good = is_good(seen, settings)
    leapt = _leapt(state, seen, passed_ns / NS_PER_S, settings)
    state = replace(
        state,
        hands_off=state.hands_off or taken_away(state, obs, settings) is not None,
        unknown_since_ns=since(state.unknown_since_ns, seen is None, now_ns),
        good_since_ns=since(state.good_since_ns, good, now_ns),
        aligned_since_ns=since(
            state.aligned_since_ns,
            seen is not None and good and _is_aligned(seen, settings),
            now_ns,
        ),
        leapt=leapt,
        tip_target=None if seen is None else seen.tip_target,
        # Where the estimate moved while the drone held, it lines up anew.
        resume=Phase.ALIGN if leapt and state.resume is Phase.APPROACH else state.resume,
    )
    return _scanned(_approached(state, seen, obs, settings), obs, settings)


def _leapt(
    state: MissionState, seen: Seen | None, passed_s: float, settings: MissionSettings
) -> bool:
    """Whether the tip moved further in the target's frame than it can have flown."""
    if seen is None or state.tip_target is None:
        return False
    moved_m = norm(moved(seen.tip_target, state.tip_target, -1.0))
    flown_m = FASTEST_MPS * min(passed_s, LATE_S)
    allowed_m = settings.leap_m + settings.leap_rad * norm(seen.tip_target)
    return not moved_m <= allowed_m + flown_m


def _is_aligned(seen: Seen, settings: MissionSettings) -> bool:
    x, y, z = seen.tip_target
    return (
        abs(x - settings.standoff_m) <= settings.standoff_tolerance_m
        and math.hypot(y, z) <= settings.aligned_m
        and abs(seen.yaw_error_rad) <= settings.aligned_rad
    )


def _approached(
    state: MissionState, seen: Seen | None, obs: Observation, settings: MissionSettings
) -> MissionState:
    """Progress of an approach, and what contact feels like."""
    if not state.phase.near or seen is None:
        return state if state.contact == UNFELT else replace(state, contact=UNFELT)
    feeling = Feeling(
        t_ns=state.now_ns,
        x_m=seen.tip_target[0],
        delta_m=state.told.delta_m,
        tip_world=seen.tip_world,
        axis_world=seen.axis_world,
        commanded_mps=state.told.commanded_mps,
        forward_m=obs.senses.forward_m,
        tip_ahead_m=seen.tip_ahead_m,
    )
    contact = feel(state.contact, feeling, settings.contact)
    if seen.tip_target[0] <= state.nearest_m - settings.progress_m:
        return replace(
            state, contact=contact, nearest_m=seen.tip_target[0], nearest_ns=state.now_ns
        )
    return replace(state, contact=contact)


def _scanned(state: MissionState, obs: Observation, settings: MissionSettings) -> MissionState:
    """Which way a search turns: back and forth around the heading that it began with."""
    heading = _heading(obs)
    if state.phase is not Phase.SEARCH or heading is None:
        return state
    if state.scan_from_rad is None:
        return replace(state, scan_from_rad=heading)
    turned = math.remainder(heading - state.scan_from_rad, math.tau)
    if turned * state.scan_sign >= settings.scan_half_rad:
        return replace(state, scan_sign=-math.copysign(1.0, turned))
    return state


def _heading(obs: Observation) -> float | None:
    heading = obs.heading_rad
    usable = heading is not None and -HEADING_MAX_RAD <= heading <= HEADING_MAX_RAD
    return heading if usable and obs.own_pose else None


def _entered(
    state: MissionState, move: Move, obs: Observation, settings: MissionSettings
) -> MissionState:
    """The state at the begin of a phase."""
    now_ns, before = state.now_ns, state.phase
    state = replace(
        state,
        phase=move.to,
        reason=move.reason,
        since_ns=now_ns,
        transition=Transition(before, move.to, move.reason, move.sentence),
    )
    match move.to:
        case Phase.SEARCH:
            if before is Phase.HOLD and state.begun_ns is not None:
                return state  # the same search goes on
            begun_ns = now_ns if state.begun_ns is None else state.begun_ns
            # Lost near the board, nobody knows how near: it does not swing its arm there. Before
            # the first attempt it has not been near.
            away = before in (Phase.BRAKE, Phase.RETREAT) and state.tip_target is None
            lost = away and state.attempts > 0
            return replace(
                state,
                begun_ns=begun_ns,
                scan_from_rad=_heading(obs),
                scan_sign=0.0 if lost else 1.0,
            )
        case Phase.ALIGN if before in (Phase.SEARCH, Phase.RETREAT):
            return replace(
                state,
                attempts=state.attempts + 1,
                attempt_ns=now_ns,
                aligned_since_ns=None,
                flickers=0,
            )
        case Phase.APPROACH:
            x_m = 0.0 if state.tip_target is None else state.tip_target[0]
            return replace(state, nearest_m=x_m, nearest_ns=now_ns, contact=UNFELT)
        case Phase.RETREAT:
            return replace(state, touched=state.touched or move.reason is Reason.DWELT)
        case Phase.HOLD:
            # A contact that was broken off is felt anew, from the approach.
            back = {Phase.CONTACT: Phase.APPROACH, Phase.BRAKE: Phase.RETREAT}
            flickers = before.near and move.reason in (Reason.TARGET_OLD, Reason.TARGET_DOUBTED)
            at = state.tip_target
            counts = flickers and at is not None and at[0] < settings.flicker_m
            return replace(
                state, resume=back.get(before, before), flickers=state.flickers + int(counts)
            )
        case Phase.ABORT:
            never_ours = state.begun_ns is None
            off = state.hands_off or never_ours or move.reason is Reason.CLOCK_STANDS
            return replace(state, hands_off=off)
        case _:
            return state


def _intent(state: MissionState, obs: Observation, settings: MissionSettings) -> Intent:
    """What the phase wants to fly."""
    blind = (
        state.begun_ns is None
        or state.hands_off
        or clock_stands(state)
        or trusted(state, obs) is None
    )
    match state.phase:
        case Phase.SEARCH:
            return Intent(blind=True, yaw_rate_radps=_scan_radps(state, obs, settings))
        case Phase.ALIGN:
            return Intent(Goal(Aim.STANDOFF, settings.standoff_m), blind)
        case Phase.APPROACH:
            return Intent(Goal(Aim.CONTACT), blind)
        case Phase.CONTACT:
            return Intent(Goal(Aim.PRESS), blind)
        case Phase.RETREAT:
            return Intent(Goal(Aim.RETREAT, settings.standoff_m), blind)
        case Phase.DONE:
            return Intent(blind=blind, give_back=True)
        case Phase.ABORT:
            return _away(state, obs, blind, settings)
        case _:
            return Intent(blind=blind)


def _scan_radps(state: MissionState, obs: Observation, settings: MissionSettings) -> float:
    if state.scan_from_rad is None or _heading(obs) is None or settings.scan_half_rad == 0.0:
        return 0.0
    if state.good_since_ns is not None or clock_stands(state):
        return 0.0  # it is in view; or nobody knows for how long it has been turning
    return state.scan_sign * settings.scan_radps


def _away(state: MissionState, obs: Observation, blind: bool, settings: MissionSettings) -> Intent:
    """Back off while it can, to the stand-off distance; then stand, and let the vehicle go."""
    if state.hands_off or state.given_back or clock_stands(state):
        return Intent(blind=blind, give_back=True)
    # One tick without knowledge gives nothing back, for that is never taken again
    unknown = lasts(state.unknown_since_ns, state.now_ns, settings.brake_s)
    lost = unknown and phase_lasts(state, settings.brake_s)
    over = lost or phase_lasts(state, settings.retreat_max_s)
    x_m = math.nan if state.tip_target is None else state.tip_target[0]
    if over or x_m >= settings.standoff_m - settings.standoff_tolerance_m:
        return Intent(blind=blind, give_back=True)
    stands = blind or obs.senses.order is Order.HOLD  # a person may see what is behind it
    return Intent(STILL if stands else Goal(Aim.RETREAT, settings.standoff_m), blind)
