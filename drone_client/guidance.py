"""What the drone would like to do: fly the tip to where the mission wants it, square to the board.

Pure, and trusted with nothing: the safety filter has the last word on every velocity. The paper's
``u = K_p (p_d - p)`` and ``K_psi (psi_d - psi)``, with a softer gain along x than across, so that
the tip is in line with the target before it is there; a closing speed that leaves the touch gentle;
and a yaw error that is wrapped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from drone_client.bounds import check_bounds
from drone_client.cbf.limits import closing_limit_mps
from drone_client.cbf.vector import ZERO, Vec3, cross, dot, moved, norm, scaled
from rgbd_wire.geometry import Pose

LEVEL_MIN = 1e-3
"""Horizontal part below which a direction has no heading: a board on the floor, an arm upright."""
LAG_SHARE_MAX = 0.5
"""Largest gain times lag: a place that is corrected through a first-order lag is damped by
``1 / (2 sqrt(k T))``, here by 0.71, and overshoots by 4 %; less gain gives way to the wind."""

_BOUNDS: dict[str, tuple[float, float]] = {
    "k_x": (0.05, 2.0),
    "k_lateral": (0.05, 2.0),
    "k_yaw": (0.05, 3.0),
    "speed_max_mps": (0.0, 2.0),
    "yaw_rate_max_radps": (0.0, 2.0),
    "push_m": (0.005, 0.05),
    "touch_mps": (0.005, 0.1),
    "press_mps": (0.005, 0.1),
    "retreat_mps": (0.02, 0.5),
    "clear_m": (0.0, 0.5),
    "brake_mps2": (0.05, 3.0),
    "square_rad": (0.05, math.pi),
    "lag_s": (0.0, 1.0),
}


@dataclass(frozen=True, slots=True)
class GuidanceSettings:
    """Gains and limits of the guidance.

    Raises:
        ValueError: a value is out of its bounds, ``k_x`` exceeds ``k_lateral``, or a gain is too
            high for the vehicle's lag.
    """

    k_x: float = 0.4
    """Gain along the target's x [1/s]."""
    k_lateral: float = 1.2
    """Gain across it [1/s]; larger, so that the tip lines up first, and gusts move it little."""
    k_yaw: float = 0.8
    """Gain of the yaw error [1/s]."""
    speed_max_mps: float = 0.4
    """Largest wanted speed."""
    yaw_rate_max_radps: float = 0.5
    """Largest wanted yaw rate."""
    push_m: float = 0.025
    """The goal lies so far behind the board that contact presses the compliant arm."""
    touch_mps: float = 0.027
    """Wanted closing speed in the plane of the board. A vehicle whose velocity comes ``T`` late
    touches at about ``touch_mps / (1 - k_x T)``: 0.033 m/s for 0.45 s of lag and delay. (Where
    ``k_x T`` is under 0.2.)"""
    press_mps: float = 0.04
    """Wanted speed into the board once it is touched: the arm holds a soft vehicle back."""
    retreat_mps: float = 0.15
    """Speed on the way back."""
    clear_m: float = 0.05
    """Nearer than this a retreat goes straight out: what is pressed is not dragged sideways."""
    brake_mps2: float = 0.3
    """Deceleration that the closing speed before it is made for."""
    square_rad: float = 0.5
    """Yaw error at which the approach waits altogether; it slows in proportion before."""
    lag_s: float = 0.3
    """Time in which the vehicle follows a velocity: what the gains must be slow for."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)
        if self.k_x > self.k_lateral:
            raise ValueError(
                f"GuidanceSettings.k_x = {self.k_x} must not exceed k_lateral = {self.k_lateral}: "
                "the tip would arrive before it is in line"
            )
        if self.k_lateral * self.lag_s > LAG_SHARE_MAX:
            raise ValueError(
                f"GuidanceSettings.k_lateral = {self.k_lateral} exceeds {LAG_SHARE_MAX:g} / lag_s "
                f"= {LAG_SHARE_MAX / self.lag_s:.3g}: the tip would swing about its goal"
            )


class Aim(StrEnum):
    """Where the tip shall go."""

    STILL = "still"
    """Nowhere, and no turn."""
    STANDOFF = "standoff"
    """To the point ``Goal.x_m`` on the axis, square to the board."""
    CONTACT = "contact"
    """Onto the board."""
    PRESS = "press"
    """Into it, by the push depth; straight, for a pressed tip must not be dragged."""
    RETREAT = "retreat"
    """Out along the axis to ``Goal.x_m``; at first straight."""


@dataclass(frozen=True, slots=True)
class Goal:
    """What a mission wants of the guidance."""

    aim: Aim
    x_m: float = 0.0
    """Of the point on the axis that STANDOFF and RETREAT go to, in frame ``target``."""


TO_CONTACT = Goal(Aim.CONTACT)
STILL = Goal(Aim.STILL)


@dataclass(frozen=True, slots=True)
class Nominal:
    """What the guidance wants; the safety filter decides."""

    velocity_tip_target: Vec3
    """Velocity of the tip in frame ``target`` [m/s]."""
    yaw_rate_radps: float
    """Positive about the world's up."""


def guide(
    target_from_tip: Pose, settings: GuidanceSettings, up_target: Vec3, goal: Goal = TO_CONTACT
) -> Nominal:
    """Wanted velocity and yaw rate for a tip at ``target_from_tip``.

    Args:
        target_from_tip: The unloaded tip; its x axis is the arm's.
        settings: Gains and limits.
        up_target: The world's up in frame ``target``, unit length.
        goal: Where to.
    """
    if goal.aim is Aim.STILL:
        return Nominal(ZERO, 0.0)
    x, y, z = (float(c) for c in target_from_tip.translation)
    if goal.aim is Aim.PRESS:
        return Nominal((-_into_mps(x, settings.press_mps, settings), 0.0, 0.0), 0.0)
    if goal.aim is Aim.RETREAT and x < settings.clear_m:
        return Nominal((settings.retreat_mps, 0.0, 0.0), 0.0)

    arm_x, arm_y, arm_z = (float(c) for c in target_from_tip.rotation[:, 0])
    error = yaw_error_rad((arm_x, arm_y, arm_z), up_target)
    squareness = max(0.0, 1.0 - abs(error) / settings.square_rad)
    along = _along_mps(x, goal, settings)
    if along < 0.0:
        along *= squareness

    velocity = (along, -settings.k_lateral * y, -settings.k_lateral * z)
    speed = norm(velocity)
    if speed > settings.speed_max_mps:
        velocity = scaled(velocity, settings.speed_max_mps / speed)
    yaw_max = settings.yaw_rate_max_radps
    return Nominal(velocity, min(max(settings.k_yaw * error, -yaw_max), yaw_max))


def _along_mps(x_m: float, goal: Goal, settings: GuidanceSettings) -> float:
    """Wanted velocity along the target's x [m/s] for a tip that is square to the board."""
    if goal.aim is Aim.CONTACT:
        return -_closing_mps(x_m, settings)
    outward = settings.k_x * (goal.x_m - x_m)
    if goal.aim is Aim.RETREAT:
        return min(max(outward, 0.0), settings.retreat_mps)
    return outward


def _closing_mps(x_m: float, settings: GuidanceSettings) -> float:
    """Wanted closing speed [m/s]: slower with the distance, ``touch_mps`` in the board's plane."""
    if x_m < 0.0:
        return _into_mps(x_m, settings.touch_mps, settings)
    limit = closing_limit_mps(x_m, settings.touch_mps, settings.brake_mps2, settings.push_m)
    return min(settings.touch_mps + settings.k_x * x_m, limit)


def _into_mps(x_m: float, speed_mps: float, settings: GuidanceSettings) -> float:
    """Speed into the board [m/s]: full in its plane, none at the push depth, outward beyond it."""
    wanted = speed_mps * (1.0 + x_m / settings.push_m)
    return min(max(wanted, -settings.retreat_mps), speed_mps)


def yaw_error_rad(arm_target: Vec3, up_target: Vec3) -> float:
    """Angle in (-pi, pi] to turn about ``up`` until the arm points into the board.

    Zero where there is no heading to turn to: a board that lies flat, an arm that points up.

    Args:
        arm_target: Direction of the arm in frame ``target``, unit length.
        up_target: The world's up in frame ``target``, unit length.
    """
    heading = _level(arm_target, up_target)
    wanted = _level((-1.0, 0.0, 0.0), up_target)
    if not (norm(heading) > LEVEL_MIN and norm(wanted) > LEVEL_MIN):
        return 0.0
    return math.atan2(dot(up_target, cross(heading, wanted)), dot(heading, wanted))


def _level(direction: Vec3, up: Vec3) -> Vec3:
    """The part of a direction that is perpendicular to up."""
    return moved(direction, up, -dot(direction, up))
