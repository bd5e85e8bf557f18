"""Whether the arm touches: three witnesses, none believed at once (docs/mission.md, "Contact").

- **motion**: the tip stands although the vehicle was told to go on. What the vehicle would have
  done is a first-order lag of the command; what it did comes from its own odometry alone, so that
  a better measurement of the target does not look like a motion.
- **deflection**: the unloaded tip is behind the board by more than the error ball, so the arm must
  be pressed.
- **lidar**: the board is as far away as the tip, if there is a forward lidar.

Pure; time is an argument. No input makes it raise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from statistics import median
from typing import NamedTuple

from drone_client.bounds import check_bounds
from drone_client.cbf.vector import Vec3, dot, is_bounded, moved
from drone_client.mission.arm import Arm

FARTHEST = 1e4
"""A place [m] or speed [m/s] beyond this is a fault, not a state."""
SAMPLES = 16
"""So many places of the tip are kept for the window of the motion, however fast the ticks."""
NS_PER_S = 1_000_000_000

_BOUNDS: dict[str, tuple[float, float]] = {
    "near_m": (0.0, 0.05),
    "near_share": (0.0, 1.0),
    "window_s": (0.1, 2.0),
    "lag_s": (0.01, 2.0),
    "delay_s": (0.0, 1.0),
    "expected_mps": (0.002, 0.1),
    "stall_share": (0.1, 0.6),
    "free_share": (0.5, 1.0),
    "force_min_n": (0.0, 20.0),
    "lidar_margin_m": (0.005, 0.2),
    "lidar_ahead_m": (-1.0, 1.0),
    "two_s": (0.05, 2.0),
    "one_s": (0.1, 5.0),
    "lost_s": (0.05, 2.0),
    "spring_back_m": (0.003, 0.1),
}


@dataclass(frozen=True, slots=True)
class ContactSettings:
    """When the arm counts as touching.

    Raises:
        ValueError: a value is out of its bounds, or two of them contradict each other.
    """

    arm: Arm = field(default_factory=Arm)
    near_m: float = 0.005
    """No witness is heard while the tip is further from the board than this and ``near_share``."""
    near_share: float = 0.33
    """Of the error ball: it holds the worst that may be, and a tip that stands at its far side is
    held by wind far more often than by a board. A board that is nearer than it seems is felt all
    the same, pressed in by the rest of the ball."""
    window_s: float = 0.5
    """Time over which motion is compared."""
    lag_s: float = 0.3
    """First-order lag with which the free vehicle follows a velocity."""
    delay_s: float = 0.05
    """What passes before it begins to."""
    expected_mps: float = 0.01
    """A free vehicle would have to close in at least so fast for its motion to say anything."""
    stall_share: float = 0.35
    """Less than this share of the expected motion is a stall."""
    free_share: float = 0.7
    """More than this share of it is free flight."""
    force_min_n: float = 0.3
    """Pressed is an arm whose spring would push so hard even at the far edge of the error ball."""
    lidar_margin_m: float = 0.03
    """How far the lidar's distance may be from that of the tip, either way."""
    lidar_ahead_m: float = 0.1
    """Where the forward lidar sits, along the body's x from the body's origin."""
    two_s: float = 0.2
    """Two witnesses must agree for so long."""
    one_s: float = 0.5
    """One alone must say so for so long."""
    lost_s: float = 0.2
    """Contact is lost when it has looked lost for so long."""
    spring_back_m: float = 0.01
    """So far back within the window, and the tip is off the board."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)
        if not self.stall_share < self.free_share:
            raise ValueError(
                f"ContactSettings.stall_share = {self.stall_share} must be less than free_share = "
                f"{self.free_share}"
            )
        settle_s = self.arm.settle_s()
        if not settle_s <= self.two_s <= self.one_s:
            raise ValueError(
                f"ContactSettings.two_s = {self.two_s} must be between {settle_s:.3f} (until a "
                f"swing of this arm has settled) and one_s = {self.one_s}"
            )


class Vote(StrEnum):
    """What one witness says."""

    YES = "yes"
    NO = "no"
    SILENT = "silent"


class Votes(NamedTuple):
    """What the three witnesses say at one tick."""

    motion: Vote = Vote.SILENT
    deflection: Vote = Vote.SILENT
    lidar: Vote = Vote.SILENT

    def __str__(self) -> str:
        return f"motion {self.motion}, deflection {self.deflection}, lidar {self.lidar}"


class _Place(NamedTuple):
    t_ns: int
    tip_world: Vec3
    free_m: float
    """Where a free vehicle would be along the axis; only differences mean anything."""


@dataclass(frozen=True, slots=True)
class Feeling:
    """What contact looks like at one tick; all that the detector needs to know."""

    t_ns: int
    """Drone's clock."""
    x_m: float
    """Estimated unloaded tip along the target's x: its height over the board."""
    delta_m: float
    """Radius of the error ball around it."""
    tip_world: Vec3
    """Unloaded tip by the drone's own odometry [m]."""
    axis_world: Vec3
    """The target's x, unit length."""
    commanded_mps: float
    """Velocity of the tip along the target's x that was commanded until now."""
    forward_m: float | None = None
    """Distance that a lidar along the body's x sees; None: there is none, or it sees nothing."""
    tip_ahead_m: float = 0.0
    """The unloaded tip along the body's x from the body's origin."""


@dataclass(frozen=True, slots=True)
class ContactState:
    """What the detector remembers."""

    touching: bool = False
    votes: Votes = Votes()
    t_ns: int | None = None
    free_mps: float = 0.0
    """Velocity along the axis that a free vehicle would have now."""
    delayed: tuple[tuple[int, float], ...] = ()
    """Commands that have not yet reached the vehicle."""
    places: tuple[_Place, ...] = ()
    pressed_since_ns: int | None = None
    """Since when at least one witness says yes and none that counts says no."""
    agreed_since_ns: int | None = None
    """Since when at least two do."""
    lost_since_ns: int | None = None
    """Since when contact looks lost."""


def feel(state: ContactState, now: Feeling, settings: ContactSettings) -> ContactState:
    """The detector one tick later.

    Args:
        state: Of the tick before; ``ContactState()`` at the start, and whenever the odometry's
            world has moved.
        now: What there is to see.
        settings: When to believe it.
    """
    if not _usable(now):
        return ContactState()
    if state.t_ns is not None and now.t_ns <= state.t_ns:
        return state  # a clock that stands or goes back says nothing new
    state = _remember(state, now, settings)
    votes = Votes(
        _by_motion(state, now, settings), _by_deflection(now, settings), _by_lidar(now, settings)
    )
    state = replace(state, votes=votes)
    return _still_touching(state, now, settings) if state.touching else _begin(state, now, settings)


def _remember(state: ContactState, now: Feeling, settings: ContactSettings) -> ContactState:
    """The free vehicle's velocity and the window of places, brought up to now."""
    t_ns = now.t_ns
    if state.t_ns is None or t_ns - state.t_ns > settings.window_s * NS_PER_S:
        return ContactState(t_ns=t_ns, places=(_Place(t_ns, now.tip_world, 0.0),))
    dt_s = (t_ns - state.t_ns) / NS_PER_S
    queue = (*state.delayed, (t_ns + round(settings.delay_s * NS_PER_S), now.commanded_mps))
    arrived = [mps for due_ns, mps in queue if due_ns <= t_ns]
    heard = arrived[-1] if arrived else state.free_mps
    fade = math.exp(-dt_s / settings.lag_s)
    free_mps = heard + fade * (state.free_mps - heard)
    # The last command that has arrived stays in force until the next one does.
    waiting = tuple(entry for entry in queue if entry[0] > t_ns)
    delayed = (((t_ns, heard), *waiting) if arrived else waiting)[-4 * SAMPLES :]
    free_m = state.places[-1].free_m + dt_s * free_mps
    places = state.places
    spacing_ns = settings.window_s * NS_PER_S / SAMPLES
    # The newest place is replaced until it is a spacing away from the one before.
    if len(places) > 1 and places[-1].t_ns - places[-2].t_ns < spacing_ns:
        places = places[:-1]
    oldest_ns = t_ns - settings.window_s * NS_PER_S
    places = (*(p for p in places if p.t_ns >= oldest_ns), _Place(t_ns, now.tip_world, free_m))
    return replace(state, t_ns=t_ns, free_mps=free_mps, delayed=delayed, places=places)


def _by_motion(state: ContactState, now: Feeling, settings: ContactSettings) -> Vote:
    """Whether the tip stands although it should go on, or goes on as if nothing were there."""
    places = state.places
    if not _is_filled(places, settings):
        return Vote.SILENT
    expected = _travel([p.free_m for p in places])
    span_s = _travel([(p.t_ns - places[0].t_ns) / NS_PER_S for p in places])
    if not expected <= -settings.expected_mps * span_s or not _is_near(now, settings):
        return Vote.SILENT
    measured = _travel(_along(places, now.axis_world))
    if measured >= settings.stall_share * expected:
        return Vote.YES
    return Vote.NO if measured <= settings.free_share * expected else Vote.SILENT


def _by_deflection(now: Feeling, settings: ContactSettings) -> Vote:
    """Whether the arm must be pressed, wherever in the error ball its tip is."""
    least_n = settings.arm.static_force_n(-now.x_m - now.delta_m)
    if least_n > 0.0 and least_n >= settings.force_min_n:
        return Vote.YES
    return Vote.SILENT if _is_near(now, settings) else Vote.NO


def _by_lidar(now: Feeling, settings: ContactSettings) -> Vote:
    """Whether the board is as far away as the unloaded tip, or nearer."""
    if now.forward_m is None or not 0.0 < now.forward_m <= FARTHEST:
        return Vote.SILENT  # a zero is what many of them say when they see nothing
    gap_m = now.forward_m - (now.tip_ahead_m - settings.lidar_ahead_m)
    return Vote.YES if gap_m <= settings.lidar_margin_m else Vote.NO


def _begin(state: ContactState, now: Feeling, settings: ContactSettings) -> ContactState:
    """Whether contact begins."""
    votes = state.votes
    denied = votes.lidar is Vote.NO or not _is_near(now, settings)
    seen = Vote.YES in (votes.motion, votes.deflection) and not denied
    agreed = seen and votes.count(Vote.YES) >= 2
    pressed_ns = _since(state.pressed_since_ns, seen, now.t_ns)
    agreed_ns = _since(state.agreed_since_ns, agreed, now.t_ns)
    touching = _lasts(agreed_ns, now.t_ns, settings.two_s) or _lasts(
        pressed_ns, now.t_ns, settings.one_s
    )
    return replace(
        state,
        touching=touching,
        pressed_since_ns=pressed_ns,
        agreed_since_ns=agreed_ns,
        lost_since_ns=None,
    )


def _still_touching(state: ContactState, now: Feeling, settings: ContactSettings) -> ContactState:
    """Whether contact goes on."""
    # Within the window alone: over a dwell, odometry may drift as far as the arm springs back.
    back_m = _travel(_along(state.places, now.axis_world))
    gone = (
        (_is_filled(state.places, settings) and back_m >= settings.spring_back_m)
        or -now.x_m - now.delta_m > settings.arm.travel_m
        or not now.x_m <= _near_m(now, settings) + settings.spring_back_m
        or state.votes.lidar is Vote.NO
    )
    lost_ns = _since(state.lost_since_ns, gone, now.t_ns)
    if _lasts(lost_ns, now.t_ns, settings.lost_s):
        # What was felt so far is no witness of a new contact.
        return ContactState(
            votes=state.votes, t_ns=state.t_ns, free_mps=state.free_mps, places=state.places[-1:]
        )
    return replace(state, lost_since_ns=lost_ns)


def _is_filled(places: tuple[_Place, ...], settings: ContactSettings) -> bool:
    return places[-1].t_ns - places[0].t_ns >= 0.8 * settings.window_s * NS_PER_S


def _along(places: tuple[_Place, ...], axis_world: Vec3) -> list[float]:
    """The places along the axis [m], from the oldest."""
    return [dot(moved(p.tip_world, places[0].tip_world, -1.0), axis_world) for p in places]


def _is_near(now: Feeling, settings: ContactSettings) -> bool:
    return now.x_m <= _near_m(now, settings)


def _near_m(now: Feeling, settings: ContactSettings) -> float:
    return settings.near_m + settings.near_share * now.delta_m


def _since(since_ns: int | None, holds: bool, now_ns: int) -> int | None:
    """Since when something holds without a break."""
    if not holds:
        return None
    return now_ns if since_ns is None else since_ns


def _lasts(since_ns: int | None, now_ns: int, time_s: float) -> bool:
    return since_ns is not None and now_ns - since_ns >= time_s * NS_PER_S


def _travel(values: list[float]) -> float:
    """From the oldest third to the newest one: their medians, which a wild sample leaves alone."""
    third = max(1, len(values) // 3)
    return median(values[-third:]) - median(values[:third])


def _usable(now: Feeling) -> bool:
    """Whether every number is one that a drone can have; comparisons alone, so that none raises."""
    return (
        -FARTHEST <= now.x_m <= FARTHEST
        and 0.0 <= now.delta_m <= FARTHEST
        and -FARTHEST <= now.commanded_mps <= FARTHEST
        and -FARTHEST <= now.tip_ahead_m <= FARTHEST
        and is_bounded(now.tip_world, 1e3 * FARTHEST)
        and is_bounded(now.axis_world, 1.01)
    )
