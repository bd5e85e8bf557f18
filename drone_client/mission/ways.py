"""The way on: what each phase waits for."""

from __future__ import annotations

from drone_client.cbf.freshness import Freshness
from drone_client.cbf.vector import dot, is_bounded
from drone_client.mission.move import (
    Move,
    is_doubted,
    lasts,
    phase_lasts,
    phase_s,
    place,
    quoted,
    trusted,
    waits_for,
)
from drone_client.mission.phase import Order, Phase, Reason
from drone_client.mission.settings import MissionSettings
from drone_client.mission.state import MissionState, Observation
from rgbd_wire.geometry import vec3

FASTEST_MPS = 1e3
"""A velocity beyond this is a fault of what says it."""


def way_on(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    """The move that the phase itself makes, if it is time."""
    if state.phase is Phase.CONTACT:
        return _contact(state, settings)
    if not phase_lasts(state, settings.settle_s):
        return None
    match state.phase:
        case Phase.SEARCH:
            return _search(state, settings)
        case Phase.ALIGN:
            return _align(state, settings)
        case Phase.APPROACH:
            return _approach(state, obs, settings)
        case Phase.RETREAT:
            return _retreat(state, obs, settings)
        case Phase.HOLD:
            return _hold(state, obs, settings)
        case Phase.BRAKE:
            return _brake(state, obs, settings)
        case _:
            return None


def _search(state: MissionState, settings: MissionSettings) -> Move | None:
    if not lasts(state.good_since_ns, state.now_ns, settings.seen_s):
        return None
    return _attempt(state, settings, Reason.TARGET_SEEN, "the target is seen well")


def _attempt(state: MissionState, settings: MissionSettings, reason: Reason, why: str) -> Move:
    """To the next attempt, or to the end of all."""
    if state.attempts >= settings.attempts:
        return Move(
            Phase.ABORT, Reason.ATTEMPTS_SPENT, f"{state.attempts} attempts came to nothing"
        )
    return Move(Phase.ALIGN, reason, f"{why}: attempt {state.attempts + 1} of {settings.attempts}")


def _align(state: MissionState, settings: MissionSettings) -> Move | None:
    if lasts(state.aligned_since_ns, state.now_ns, settings.aligned_s):
        return Move(
            Phase.APPROACH,
            Reason.ALIGNED,
            f"at the stand-off point for {settings.aligned_s:g} s: {place(state)}",
        )
    return None


def _approach(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    if state.contact.touching:
        return Move(
            Phase.CONTACT,
            Reason.TOUCHED,
            f"the arm touches: {state.contact.votes}, {place(state)}",
        )
    closing_mps = _closing_mps(obs)
    if closing_mps is not None and _pushed(state, closing_mps, settings):
        return Move(
            Phase.RETREAT,
            Reason.PUSHED,
            f"closes in at {closing_mps:.3f} m/s, told to at {-state.told.commanded_mps:.3f}: "
            f"{place(state)}",
        )
    if lasts(state.nearest_ns, state.now_ns, settings.progress_s):
        return Move(
            Phase.RETREAT,
            Reason.NO_PROGRESS,
            f"no {settings.progress_m * 1e3:g} mm nearer in {settings.progress_s:g} s, nearest "
            f"{state.nearest_m:.3f} m",
        )
    if lasts(state.attempt_ns, state.now_ns, settings.attempt_max_s):
        return Move(
            Phase.RETREAT,
            Reason.ATTEMPT_TOO_LONG,
            f"no contact {settings.attempt_max_s:g} s after the attempt began",
        )
    return None


def _closing_mps(obs: Observation) -> float | None:
    """How fast the body comes towards the board [m/s]; None: the vehicle does not say."""
    vehicle = obs.senses.vehicle
    said = None if vehicle is None else vehicle.velocity_world
    if obs.seen is None or said is None or said.shape != (3,):
        return None
    velocity = vec3(said)
    return -dot(obs.seen.axis_world, velocity) if is_bounded(velocity, FASTEST_MPS) else None


def _pushed(state: MissionState, closing_mps: float, settings: MissionSettings) -> bool:
    """Whether something drives the drone on, and there is room yet to turn."""
    if state.tip_target is None:
        return False
    x_m, told_mps = state.tip_target[0], max(0.0, -state.told.commanded_mps)
    return (
        closing_mps > told_mps + settings.pushed_mps
        and settings.turn_s * closing_mps < x_m < settings.pushed_m
    )


def _contact(state: MissionState, settings: MissionSettings) -> Move | None:
    if not state.contact.touching:
        return Move(
            Phase.RETREAT,
            Reason.CONTACT_LOST,
            f"contact lost after {phase_s(state):.1f} s: {place(state)}",
        )
    if phase_lasts(state, settings.dwell_s):
        return Move(Phase.RETREAT, Reason.DWELT, f"{_dwelt(state, settings)}: {place(state)}")
    return None


def _dwelt(state: MissionState, settings: MissionSettings) -> str:
    x_m = 0.0 if state.tip_target is None else state.tip_target[0]
    force_n = settings.contact.arm.static_force_n(-x_m)
    return f"pressed for {phase_s(state):.1f} s, the arm with about {force_n:.1f} N"


def _retreat(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    seen = trusted(state, obs)
    if seen is None:
        return _unknown(state)
    if not seen.tip_target[0] >= settings.standoff_m - settings.standoff_tolerance_m:
        return None
    if state.touched:
        return Move(Phase.DONE, Reason.BACK, f"contact made, and back: {place(state)}")
    if lasts(state.good_since_ns, state.now_ns, settings.good_s):
        return _attempt(state, settings, Reason.TRY_AGAIN, "back at the stand-off point")
    if seen.freshness is Freshness.FRESH:
        return None  # it is being seen again: a moment more
    if state.attempts >= settings.attempts:
        return _attempt(state, settings, Reason.TRY_AGAIN, "")
    return Move(
        Phase.SEARCH, Reason.TARGET_LOST, "back at the stand-off point, target out of sight"
    )


def _unknown(state: MissionState) -> Move:
    """Nothing to go back along; what was touched need not be searched for again."""
    if state.touched:
        return Move(Phase.ABORT, Reason.TARGET_LOST, "target lost on the way back from contact")
    return Move(Phase.SEARCH, Reason.TARGET_LOST, "nothing is known of the target any more")


def _hold(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    if state.begun_ns is None:
        return _begin(state, obs, settings)
    if obs.senses.order is Order.HOLD:
        return None
    if state.resume is Phase.RETREAT:
        return Move(Phase.RETREAT, Reason.GOOD_AGAIN, "goes on with the retreat")
    if state.resume is Phase.APPROACH and state.flickers >= settings.flickers:
        return Move(
            Phase.RETREAT,
            Reason.FLICKERS,
            f"halted {state.flickers} times near the board, for the target comes and goes",
        )
    seen = trusted(state, obs)
    if state.resume is Phase.SEARCH:
        doubted = seen is not None and is_doubted(seen, settings)
        if seen is None or not doubted or seen.freshness is not Freshness.FRESH:
            return Move(Phase.SEARCH, Reason.GOOD_AGAIN, "nothing contradicts any more")
    elif lasts(state.good_since_ns, state.now_ns, settings.good_s):
        return Move(
            state.resume, Reason.GOOD_AGAIN, f"the target is seen well for {settings.good_s:g} s"
        )
    if phase_lasts(state, settings.hold_max_s):
        to = Phase.SEARCH if state.resume is Phase.SEARCH else Phase.RETREAT
        return Move(to, Reason.HOLD_TOO_LONG, f"held for {phase_s(state):.1f} s")
    return None


def _begin(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    """From waiting to searching, as soon as the vehicle is ours and well, and a person says GO."""
    if obs.senses.order is Order.HOLD or waits_for(obs, settings) is not None:
        return None
    vehicle = obs.senses.vehicle
    if vehicle is None:
        return Move(Phase.SEARCH, Reason.VEHICLE_READY, "no vehicle to wait for")
    return Move(
        Phase.SEARCH, Reason.VEHICLE_READY, f"the vehicle obeys in mode {quoted(vehicle.mode, 40)}"
    )


def _brake(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    if not phase_lasts(state, settings.brake_s) or obs.senses.odometry_jumped or not obs.own_pose:
        return None
    if obs.senses.order is Order.HOLD:
        return Move(Phase.HOLD, Reason.ORDERED_HOLD, "halted by a person")
    seen = trusted(state, obs)
    if obs.seen is None:
        return _unknown(state)
    if seen is None or seen.freshness is Freshness.BRAKE:
        return None
    if seen.freshness is Freshness.RETREAT:
        return Move(Phase.RETREAT, Reason.TARGET_LOST, "out of sight for too long: backs off blind")
    return Move(Phase.RETREAT, Reason.BRAKED, f"stands, and knows where: {place(state)}")
