"""Every number of a mission, in one frozen value; docs/mission.md says where they are from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from drone_client.bounds import check_bounds
from drone_client.mission.contact import ContactSettings

_BOUNDS: dict[str, tuple[float, float]] = {
    "standoff_m": (0.3, 5.0),
    "standoff_tolerance_m": (0.01, 0.3),
    "aligned_m": (0.005, 0.2),
    "aligned_rad": (0.01, 0.5),
    "aligned_s": (0.1, 10.0),
    "seen_s": (0.1, 10.0),
    "good_s": (0.1, 10.0),
    "settle_s": (0.1, 2.0),
    "brake_s": (0.2, 5.0),
    "dwell_s": (0.1, 60.0),
    "attempts": (1, 10),
    "progress_m": (0.002, 0.2),
    "progress_s": (1.0, 60.0),
    "pushed_mps": (0.01, 2.0),
    "pushed_m": (0.0, 1.0),
    "turn_s": (0.0, 2.0),
    "flickers": (1, 100),
    "flicker_m": (0.0, 1.0),
    "leap_m": (0.005, 0.5),
    "leap_rad": (0.0, 0.5),
    "doubt_outliers": (1, 10),
    "scan_half_rad": (0.0, math.pi),
    "scan_radps": (0.0, 0.5),
    "battery_min": (0.0, 0.9),
    "silent_s": (0.5, 30.0),
    "waiting_max_s": (1.0, 3600.0),
    "search_max_s": (1.0, 600.0),
    "align_max_s": (1.0, 600.0),
    "attempt_max_s": (2.0, 600.0),
    "retreat_max_s": (1.0, 300.0),
    "hold_max_s": (0.5, 300.0),
    "brake_max_s": (1.0, 300.0),
    "mission_max_s": (5.0, 3600.0),
}


@dataclass(frozen=True, slots=True)
class MissionSettings:
    """Places, times and limits of a mission.

    Raises:
        ValueError: a value is out of its bounds, or two of them contradict each other.
    """

    contact: ContactSettings = field(default_factory=ContactSettings)
    """When the arm counts as touching."""

    standoff_m: float = 1.0
    """Where on the target's axis the tip lines up and comes back to, from the board."""
    standoff_tolerance_m: float = 0.08
    """How far from there along the axis is there."""
    aligned_m: float = 0.05
    """Lined up is a tip no further than this from the axis."""
    aligned_rad: float = 0.1
    """And with no more than this left to turn."""
    aligned_s: float = 0.5
    """For so long."""
    seen_s: float = 0.5
    """The target counts as found when it was seen well for so long."""
    dwell_s: float = 2.0
    """How long contact is kept."""
    attempts: int = 3
    """Approaches at most."""

    good_s: float = 0.3
    """After a hold, knowledge must be good for so long."""
    settle_s: float = 0.3
    """No phase is left for one that flies on before it has lasted so long: phases cannot rattle."""
    brake_s: float = 0.5
    """A brake lasts at least so long: the vehicle's lag and some."""
    progress_m: float = 0.01
    """An approach must come nearer by this much"""
    progress_s: float = 6.0
    """within this time."""
    pushed_mps: float = 0.05
    """An approach is given up where the drone closes in faster by this than it was told to: wind
    pushes it on,"""
    pushed_m: float = 0.1
    """nearer to the board than this,"""
    turn_s: float = 0.4
    """and further from the touch than this: later, a vehicle that is told to go back pitches its
    tip up and touches all the same, beside the mouth."""
    flickers: int = 3
    """An attempt that has halted so often for knowledge that is old or doubtful is given up,"""
    flicker_m: float = 0.1
    """halts nearer to the board than this alone counted: a tip that comes and goes there will not
    always come to the mouth."""
    leap_m: float = 0.05
    """The tip cannot move by more between two ticks, beside what it can fly; if its place in the
    target's frame does, it is the estimate that has moved."""
    leap_rad: float = 0.05
    """And by this much times its distance: an angle of the target that gets better."""
    doubt_outliers: int = 2
    """So many measurements in a row that contradict the estimate make it doubtful."""

    scan_half_rad: float = 0.0
    """How far to either side a search turns; 0: it does not."""
    scan_radps: float = 0.15
    """How fast."""

    battery_min: float = 0.2
    """Below this fraction of the battery the mission ends."""
    silent_s: float = 3.0
    """An autopilot that was not heard for so long is lost: three heartbeats."""
    needs_vehicle: bool = True
    """Fly only while the autopilot says that it obeys; off where there is none, as in a replay."""

    waiting_max_s: float = 600.0
    """For a vehicle that takes commands."""
    search_max_s: float = 60.0
    """For the target."""
    align_max_s: float = 45.0
    """To the stand-off point."""
    attempt_max_s: float = 90.0
    """One attempt, its holds included, until contact."""
    retreat_max_s: float = 30.0
    """Back to the stand-off point."""
    hold_max_s: float = 10.0
    """For knowledge that is good again."""
    brake_max_s: float = 10.0
    """For knowing again where the drone is."""
    mission_max_s: float = 300.0
    """From the first command that the vehicle takes."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)
        for smaller, larger in (
            ("standoff_tolerance_m", "standoff_m"),
            ("brake_s", "brake_max_s"),
            ("good_s", "hold_max_s"),
            ("attempt_max_s", "mission_max_s"),
        ):
            low, high = getattr(self, smaller), getattr(self, larger)
            if not low < high:
                raise ValueError(
                    f"MissionSettings.{smaller} = {low} must be less than {larger} = {high}"
                )
