"""What ends a mission, in whatever phase it is: the first thing that is looked for."""

from __future__ import annotations

from drone_client.cbf.status import Status
from drone_client.mission.move import (
    Move,
    clock_stands,
    lasts,
    phase_lasts,
    phase_s,
    place,
    quoted,
    waits_for,
)
from drone_client.mission.phase import Order, Phase, Reason
from drone_client.mission.settings import MissionSettings
from drone_client.mission.state import MissionState, Observation


def taken_away(
    state: MissionState, obs: Observation, settings: MissionSettings
) -> tuple[Reason, str] | None:
    """Why the vehicle is not ours any more; None: it is, or it has never been.

    What the pilot, the autopilot's failsafe or the ground has taken is never taken back: the
    mission is over, even if the vehicle obeys again a moment later.
    """
    if state.begun_ns is None:
        return None
    vehicle = obs.senses.vehicle
    if vehicle is None:
        if settings.needs_vehicle:
            return Reason.VEHICLE_SILENT, "nothing is known of the vehicle any more"
        return None
    if vehicle.failsafe:
        return Reason.FAILSAFE, f"failsafe of the autopilot: {quoted(vehicle.failsafe, 80)}"
    if vehicle.landed:
        return Reason.LANDED, "the vehicle has landed"
    if not vehicle.obeying:
        return Reason.PILOT, f"in mode {quoted(vehicle.mode, 40)} the vehicle takes no commands"
    if lasts(vehicle.t_heard_ns, obs.now_ns, settings.silent_s):
        return Reason.VEHICLE_SILENT, f"autopilot not heard for over {settings.silent_s:g} s"
    return None


def end(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    """The move to ABORT, if anything asks for it."""
    why = taken_away(state, obs, settings) or _ordered(state, obs, settings)
    if why is None and state.begun_ns is not None:
        why = _timeless(state) or _flown_wrong(state) or _too_long(state, settings)
    return None if why is None else Move(Phase.ABORT, *why)


def _ordered(
    state: MissionState, obs: Observation, settings: MissionSettings
) -> tuple[Reason, str] | None:
    """A person, a silent VIO, an empty battery; and a vehicle that never came."""
    if obs.senses.order is Order.ABORT:
        return Reason.ORDERED_ABORT, "ended by a person"
    if state.begun_ns is None:
        if phase_lasts(state, settings.waiting_max_s):
            lacks = waits_for(obs, settings) or "no vehicle took commands"
            return Reason.WAITED_TOO_LONG, f"{lacks}, after {settings.waiting_max_s:g} s of waiting"
        return None
    if obs.senses.odometry_silent:
        return (
            Reason.ODOMETRY_SILENT,
            "the VIO has fallen silent: backs off while the IMU still leads",
        )
    battery = None if obs.senses.vehicle is None else obs.senses.vehicle.battery_fraction
    if battery is not None and battery < settings.battery_min:  # not said, or NaN: not known
        return (
            Reason.BATTERY_LOW,
            f"battery at {battery:.0%}, below {settings.battery_min:.0%}",
        )
    return None


def _timeless(state: MissionState) -> tuple[Reason, str] | None:
    """A clock that stands makes everything look as fresh as it ever was."""
    if not clock_stands(state):
        return None
    return Reason.CLOCK_STANDS, f"the clock has not gone on for {state.stood} ticks"


def _flown_wrong(state: MissionState) -> tuple[Reason, str] | None:
    """The safety filter's ABORT, once, is the end of the approach (docs/cbf.md, section 7)."""
    if state.told.status is not Status.ABORT:
        return None
    return Reason.FILTER_ABORT, f"the safety filter aborts: {place(state)}"


def _too_long(state: MissionState, settings: MissionSettings) -> tuple[Reason, str] | None:
    """A phase, or the whole, that should have been over; what is pressed ends by its dwell."""
    limit = {
        Phase.SEARCH: (Reason.SEARCH_TOO_LONG, settings.search_max_s),
        Phase.ALIGN: (Reason.ALIGN_TOO_LONG, settings.align_max_s),
        Phase.RETREAT: (Reason.RETREAT_TOO_LONG, settings.retreat_max_s),
        Phase.BRAKE: (Reason.BRAKE_TOO_LONG, settings.brake_max_s),
    }.get(state.phase)
    if limit is not None and phase_lasts(state, limit[1]):
        return limit[0], f"{state.phase} for {phase_s(state):.1f} s, over {limit[1]:g} s"
    if lasts(state.begun_ns, state.now_ns, settings.mission_max_s):
        return Reason.MISSION_TOO_LONG, f"mission takes over {settings.mission_max_s:g} s"
    return None
