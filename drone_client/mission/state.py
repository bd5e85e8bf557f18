"""What a mission sees at one tick, what it remembers, and what it wants."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from drone_client.autopilot import VehicleState
from drone_client.cbf.freshness import Freshness
from drone_client.cbf.status import Status
from drone_client.cbf.vector import Vec3
from drone_client.guidance import STILL, Goal
from drone_client.mission.contact import ContactState
from drone_client.mission.phase import Order, Phase, Reason


@dataclass(frozen=True, slots=True)
class Seen:
    """The target and the tip, as far as both are known."""

    tip_target: Vec3
    """Unloaded tip in frame ``target`` [m]."""
    tip_world: Vec3
    """The same by the drone's own odometry alone."""
    axis_world: Vec3
    """The target's x, unit length."""
    yaw_error_rad: float
    """Still to turn until the arm points into the board."""
    age_ns: int
    """Of the newest measurement of the target."""
    freshness: Freshness
    """What the safety filter makes of that age."""
    outliers: int = 0
    """Measurements in a row that contradict the estimate."""
    tip_ahead_m: float = 0.0
    """The tip along the body's x from the body's origin."""


@dataclass(frozen=True, slots=True)
class Senses:
    """What the drone notices beside the target; every field has a default that says nothing."""

    vehicle: VehicleState | None = None
    """What the autopilot said last; None: never heard."""
    odometry_silent: bool = False
    """The robot's VIO says nothing any more."""
    odometry_jumped: bool = False
    """The odometry's world has moved, and what was known in it does not hold."""
    forward_m: float | None = None
    """What a lidar along the body's x sees; None: there is none, or it sees nothing."""
    order: Order = Order.GO
    """What a person wants."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Everything that a mission looks at in one tick."""

    now_ns: int
    """Drone's clock."""
    seen: Seen | None
    """None: the target was never seen, or the drone does not know where it is."""
    own_pose: bool
    """The drone knows where it is."""
    heading_rad: float | None = None
    """Of the body about the world's up; None: not known."""
    senses: Senses = field(default_factory=Senses)


class Told(NamedTuple):
    """What became of the intent before: the filter's answer, for the next tick to see."""

    status: Status | None = None
    """None: the filter was not asked."""
    delta_m: float = 0.0
    """Radius of the error ball."""
    commanded_mps: float = 0.0
    """Velocity of the tip along the target's x that was commanded."""


@dataclass(frozen=True, slots=True)
class Transition:
    """From one phase to another, and why."""

    before: Phase
    after: Phase
    reason: Reason
    sentence: str
    """The reason with its numbers, for people."""


@dataclass(frozen=True, slots=True)
class MissionState:
    """Where a mission is. Only ``machine.step`` makes a new one."""

    phase: Phase
    reason: Reason
    """Why this phase."""
    since_ns: int
    """Begin of the phase, drone's clock."""
    now_ns: int
    """Last tick; never goes back."""
    stood: int = 0
    """For so many ticks in a row the clock has not gone on."""
    transition: Transition | None = None
    """What happened in the last tick; None: nothing."""

    begun_ns: int | None = None
    """When the vehicle took commands first; None: it never has."""
    hands_off: bool = False
    """The vehicle was taken from us: nothing is commanded any more but to stand."""
    given_back: bool = False
    """We have let it go."""

    resume: Phase = Phase.SEARCH
    """Where a hold leads back to."""
    attempts: int = 0
    attempt_ns: int = 0
    """When the present attempt began."""
    flickers: int = 0
    """Halts near the board in this attempt."""
    touched: bool = False
    """The dwell is over: what is left is the way back."""
    nearest_m: float = 0.0
    """Nearest to the board in this approach,"""
    nearest_ns: int = 0
    """and when."""
    contact: ContactState = field(default_factory=ContactState)
    scan_from_rad: float | None = None
    """Heading that a search turns around."""
    scan_sign: float = 1.0

    lost_ns: int | None = None
    """When the drone last did not know where it is: older measurements do not count any more."""
    unknown_since_ns: int | None = None
    """Since when nothing that may be flown by is known of the target."""
    good_since_ns: int | None = None
    """Since when the target is seen well."""
    aligned_since_ns: int | None = None
    tip_target: Vec3 | None = None
    """At the last tick."""
    leapt: bool = False
    """Whether the estimate moved further than the drone can fly, in the last tick."""
    told: Told = Told()


@dataclass(frozen=True, slots=True)
class Intent:
    """What the mission wants until the next tick."""

    goal: Goal = STILL
    """For the guidance."""
    blind: bool = False
    """What is known of places must not be used: stand, without guidance and filter."""
    yaw_rate_radps: float = 0.0
    """To turn with while standing blind: the scan of a search."""
    give_back: bool = False
    """The vehicle should be given back: there is nothing left to do, or it is not ours."""
