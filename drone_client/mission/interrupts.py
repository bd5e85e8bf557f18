"""What stops a mission (BRAKE) or halts it (HOLD) in whatever phase it is."""

from __future__ import annotations

from drone_client.cbf.freshness import Freshness
from drone_client.mission.move import Move, is_doubted, last_seen, trusted
from drone_client.mission.phase import Order, Phase, Reason
from drone_client.mission.settings import MissionSettings
from drone_client.mission.state import MissionState, Observation, Seen

_FLIES_BY_THE_TARGET = (Phase.ALIGN, Phase.APPROACH, Phase.CONTACT)


def interrupt(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    """The move to BRAKE or HOLD, if anything asks for it."""
    if state.begun_ns is None:
        return None
    if state.phase is Phase.BRAKE:
        return None  # it stands already; how it goes on is its own matter
    return _brake(state, obs) or _hold(state, obs, settings)


def _brake(state: MissionState, obs: Observation) -> Move | None:
    if obs.senses.odometry_jumped:
        return Move(
            Phase.BRAKE, Reason.ODOMETRY_JUMPED, "the odometry jumped: no place holds any more"
        )
    if not obs.own_pose:
        return Move(Phase.BRAKE, Reason.OWN_POSE_UNKNOWN, "the drone does not know where it is")
    if state.phase.near and state.leapt:
        return Move(
            Phase.BRAKE,
            Reason.TARGET_LEAPT,
            "the estimate of the target moved further than the drone can fly",
        )
    waits = state.phase is Phase.HOLD and state.resume in _FLIES_BY_THE_TARGET
    if state.phase in _FLIES_BY_THE_TARGET or waits:
        return _lost(trusted(state, obs))
    return None


def _lost(seen: Seen | None) -> Move | None:
    if seen is None:
        return Move(Phase.BRAKE, Reason.TARGET_LOST, "nothing is known of the target any more")
    if seen.freshness in (Freshness.BRAKE, Freshness.RETREAT):
        return Move(Phase.BRAKE, Reason.TARGET_LOST, last_seen(seen))
    return None


def _hold(state: MissionState, obs: Observation, settings: MissionSettings) -> Move | None:
    if state.phase is Phase.HOLD:
        return None
    if obs.senses.order is Order.HOLD:
        return Move(Phase.HOLD, Reason.ORDERED_HOLD, "halted by a person")
    seen = trusted(state, obs)
    if seen is None or state.phase is Phase.RETREAT:
        return None  # away from the board is right, however old or doubtful the target is
    if is_doubted(seen, settings) and seen.freshness is Freshness.FRESH:
        return Move(
            Phase.HOLD,
            Reason.TARGET_DOUBTED,
            f"{min(seen.outliers, 10**6)} measurements in a row contradict the target's place",
        )
    if state.phase in _FLIES_BY_THE_TARGET and seen.freshness is not Freshness.FRESH:
        return Move(Phase.HOLD, Reason.TARGET_OLD, last_seen(seen))
    return None
