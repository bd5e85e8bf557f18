"""The words of a mission: its phases, and why it went from one to another."""

from __future__ import annotations

from enum import StrEnum


class Phase(StrEnum):
    """What the drone is doing; docs/mission.md draws the ways between them."""

    SEARCH = "search"
    """Holds its place, turns slowly if it may, until the target is seen well."""
    ALIGN = "align"
    """Goes to the stand-off point on the target's axis, square to the board."""
    APPROACH = "approach"
    """Closes in along the axis."""
    CONTACT = "contact"
    """Presses the arm against the target for the dwell."""
    RETREAT = "retreat"
    """Backs off along the axis to the stand-off point."""
    DONE = "done"
    """Touched and back at the stand-off point. Final."""
    HOLD = "hold"
    """Stands and waits: for the vehicle, for a person, for knowledge that is good again."""
    BRAKE = "brake"
    """Stopped: what was known does not hold any more."""
    ABORT = "abort"
    """The mission has ended badly: backs off if it may, then stays away. Final."""

    @property
    def final(self) -> bool:
        """No way leads on; a new mission is a new state."""
        return self in (Phase.DONE, Phase.ABORT)

    @property
    def near(self) -> bool:
        """On the way to the board or on it."""
        return self in (Phase.APPROACH, Phase.CONTACT)


class Reason(StrEnum):
    """Why a phase began; the sentence beside it has the numbers."""

    WAITING = "waiting"
    """The vehicle does not take commands yet."""
    VEHICLE_READY = "vehicle_ready"
    TARGET_SEEN = "target_seen"
    ALIGNED = "aligned"
    TOUCHED = "touched"
    DWELT = "dwelt"
    """Pressed for as long as it should."""
    BACK = "back"
    """At the stand-off point after contact."""
    TRY_AGAIN = "try_again"
    """At the stand-off point after an approach that came to nothing."""
    GOOD_AGAIN = "good_again"

    TARGET_OLD = "target_old"
    """The newest measurement is older than allowed."""
    TARGET_DOUBTED = "target_doubted"
    """Measurements contradict the estimate."""
    TARGET_LEAPT = "target_leapt"
    """The estimate moved further than the drone can fly."""
    TARGET_LOST = "target_lost"
    """Too old for anything but a way back, or gone altogether."""
    ODOMETRY_JUMPED = "odometry_jumped"
    OWN_POSE_UNKNOWN = "own_pose_unknown"
    ORDERED_HOLD = "ordered_hold"
    """A person said so."""
    HOLD_TOO_LONG = "hold_too_long"
    BRAKED = "braked"
    """Stands again, and knows where: back to the stand-off point first."""
    PUSHED = "pushed"
    """The drone closes in faster than it was told to."""
    FLICKERS = "flickers"
    """The target comes and goes, with the tip near the board."""
    NO_PROGRESS = "no_progress"
    ATTEMPT_TOO_LONG = "attempt_too_long"
    CONTACT_LOST = "contact_lost"

    FILTER_ABORT = "filter_abort"
    """The safety filter found the tip where it may not be, or numbers that are none."""
    CLOCK_STANDS = "clock_stands"
    """The drone's clock does not go on: how old anything is cannot be told."""
    PILOT = "pilot"
    """The vehicle does not take our commands any more."""
    LANDED = "landed"
    FAILSAFE = "failsafe"
    VEHICLE_SILENT = "vehicle_silent"
    BATTERY_LOW = "battery_low"
    ODOMETRY_SILENT = "odometry_silent"
    """Without VIO the autopilot flies by its IMU alone, and drifts more with every second."""
    ORDERED_ABORT = "ordered_abort"
    WAITED_TOO_LONG = "waited_too_long"
    SEARCH_TOO_LONG = "search_too_long"
    ALIGN_TOO_LONG = "align_too_long"
    RETREAT_TOO_LONG = "retreat_too_long"
    BRAKE_TOO_LONG = "brake_too_long"
    MISSION_TOO_LONG = "mission_too_long"
    ATTEMPTS_SPENT = "attempts_spent"


class Order(StrEnum):
    """What a person wants of a running mission."""

    GO = "go"
    HOLD = "hold"
    """Stand and wait until GO."""
    ABORT = "abort"
    """End it: back off and stay away."""
