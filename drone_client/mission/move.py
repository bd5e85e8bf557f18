"""What the rules of the mission share: a move to another phase, times, and what may be trusted."""

from __future__ import annotations

from typing import NamedTuple

from drone_client.cbf.freshness import Freshness
from drone_client.mission.phase import Phase, Reason
from drone_client.mission.settings import MissionSettings
from drone_client.mission.state import MissionState, Observation, Seen

NS_PER_S = 1_000_000_000
STOOD_TICKS = 5
"""A clock that does not go on between so many ticks in a row is broken."""


class Move(NamedTuple):
    """Where to, why, and the numbers for people."""

    to: Phase
    reason: Reason
    sentence: str


def lasts(since_ns: int | None, now_ns: int, time_s: float) -> bool:
    """Whether something has held for so long."""
    return since_ns is not None and now_ns - since_ns >= round(time_s * NS_PER_S)


def since(since_ns: int | None, holds: bool, now_ns: int) -> int | None:
    """Since when something holds without a break; None: it does not."""
    if not holds:
        return None
    return now_ns if since_ns is None else since_ns


def phase_lasts(state: MissionState, time_s: float) -> bool:
    """Whether the phase is so old."""
    return lasts(state.since_ns, state.now_ns, time_s)


def phase_s(state: MissionState) -> float:
    """Age of the phase [s], for people."""
    return (state.now_ns - state.since_ns) / NS_PER_S


def clock_stands(state: MissionState) -> bool:
    """Whether time has stood still for so many ticks that no age means anything any more."""
    return state.stood >= STOOD_TICKS


def trusted(state: MissionState, obs: Observation) -> Seen | None:
    """The target, unless what is known of it is from before the drone lost its own place."""
    seen = obs.seen
    if seen is None or obs.senses.odometry_jumped or not obs.own_pose:
        return None
    if state.lost_ns is not None and state.now_ns - seen.age_ns <= state.lost_ns:
        return None
    return seen


def is_doubted(seen: Seen, settings: MissionSettings) -> bool:
    """Whether measurements contradict the estimate."""
    return seen.outliers >= settings.doubt_outliers


def is_good(seen: Seen | None, settings: MissionSettings) -> bool:
    """Whether the target is known well enough to come nearer by it."""
    return seen is not None and seen.freshness is Freshness.FRESH and not is_doubted(seen, settings)


def last_seen(seen: Seen) -> str:
    """How long ago the target was seen, for people; absurd ages are cut."""
    age_ms = min(max(seen.age_ns, -(10**15)), 10**15) / 1e6
    return f"the target was last seen {age_ms:.0f} ms ago"


def quoted(text: str, length: int) -> str:
    """What another machine says, fit for a log: short and printable."""
    return "".join(c if c.isprintable() else "?" for c in text[:length])


def place(state: MissionState) -> str:
    """Where the tip is, for people."""
    if state.tip_target is None:
        return "tip unknown"
    return "tip at ({:.3f}, {:.3f}, {:.3f}) m".format(*state.tip_target)


def waits_for(obs: Observation, settings: MissionSettings) -> str | None:
    """What a mission that has not begun lacks, for people; None: the vehicle is ready for it.

    What the vehicle does not say counts as lacking: one that may stand on the ground is not flown.
    """
    vehicle = obs.senses.vehicle
    if vehicle is None:
        return "nothing is heard of a vehicle" if settings.needs_vehicle else None
    battery = vehicle.battery_fraction
    if lasts(vehicle.t_heard_ns, obs.now_ns, settings.silent_s):
        return f"autopilot not heard for over {settings.silent_s:g} s"
    if vehicle.failsafe:
        return f"failsafe of the autopilot: {quoted(vehicle.failsafe, 80)}"
    if not vehicle.obeying:
        return f"in mode {quoted(vehicle.mode, 40)} the vehicle takes no commands"
    if vehicle.landed is None:
        return "the autopilot does not say whether it flies (EXTENDED_SYS_STATE)"
    if vehicle.landed:
        return "the vehicle stands on the ground"
    if battery is not None and battery < settings.battery_min:
        return f"battery at {battery:.0%}, below {settings.battery_min:.0%}"
    return None
