"""What the drone would like to do: fly the tip onto the target, square to the board.

Pure, and trusted with nothing: the safety filter has the last word on every velocity. The paper's
``u = K_p (p_d - p)`` and ``K_psi (psi_d - psi)``, with a softer gain along x than across, so that
the tip is in line with the target before it is there; a closing speed that leaves the touch gentle;
and a yaw error that is wrapped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drone_client.cbf.limits import closing_limit_mps
from drone_client.cbf.vector import Vec3, cross, dot, moved, norm, scaled
from rgbd_wire.geometry import Pose

LEVEL_MIN = 1e-3
"""Horizontal part below which a direction has no heading: a board on the floor, an arm upright."""

_BOUNDS: dict[str, tuple[float, float]] = {
    "k_x": (0.05, 2.0),
    "k_lateral": (0.05, 2.0),
    "k_yaw": (0.05, 3.0),
    "speed_max_mps": (0.0, 2.0),
    "yaw_rate_max_radps": (0.0, 2.0),
    "push_m": (0.0, 0.05),
    "touch_mps": (0.005, 0.2),
    "brake_mps2": (0.05, 3.0),
    "square_rad": (0.05, math.pi),
}


@dataclass(frozen=True, slots=True)
class GuidanceSettings:
    """Gains and limits of the guidance.

    Raises:
        ValueError: a value is out of its bounds, or ``k_x`` exceeds ``k_lateral``.
    """

    k_x: float = 0.4
    """Gain along the target's x [1/s]."""
    k_lateral: float = 0.8
    """Gain across it [1/s]; larger, so that the tip lines up first."""
    k_yaw: float = 0.8
    """Gain of the yaw error [1/s]."""
    speed_max_mps: float = 0.4
    """Largest wanted speed."""
    yaw_rate_max_radps: float = 0.5
    """Largest wanted yaw rate."""
    push_m: float = 0.025
    """The goal lies so far behind the board that contact presses the compliant arm."""
    touch_mps: float = 0.08
    """Closing speed at the touch."""
    brake_mps2: float = 0.3
    """Deceleration that the closing speed before it is made for."""
    square_rad: float = 0.5
    """Yaw error at which the approach waits altogether; it slows in proportion before."""

    def __post_init__(self) -> None:
        for name, (low, high) in _BOUNDS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"GuidanceSettings.{name} = {value} is not in [{low:g}, {high:g}]")
        if self.k_x > self.k_lateral:
            raise ValueError(
                f"GuidanceSettings.k_x = {self.k_x} must not exceed k_lateral = {self.k_lateral}: "
                "the tip would arrive before it is in line"
            )


@dataclass(frozen=True, slots=True)
class Nominal:
    """What the guidance wants; the safety filter decides."""

    velocity_tip_target: Vec3
    """Velocity of the tip in frame ``target`` [m/s]."""
    yaw_rate_radps: float
    """Positive about the world's up."""


def guide(target_from_tip: Pose, settings: GuidanceSettings, up_target: Vec3) -> Nominal:
    """Wanted velocity and yaw rate for a tip at ``target_from_tip``.

    Args:
        target_from_tip: The unloaded tip; its x axis is the arm's.
        settings: Gains and limits.
        up_target: The world's up in frame ``target``, unit length.
    """
    x, y, z = (float(c) for c in target_from_tip.translation)
    arm_x, arm_y, arm_z = (float(c) for c in target_from_tip.rotation[:, 0])
    error = yaw_error_rad((arm_x, arm_y, arm_z), up_target)

    along = -settings.k_x * (x + settings.push_m)
    limit = closing_limit_mps(
        x, settings.touch_mps, settings.brake_mps2, max(settings.push_m, LEVEL_MIN)
    )
    squareness = max(0.0, 1.0 - abs(error) / settings.square_rad)
    along = max(along, -limit * squareness)

    velocity = (along, -settings.k_lateral * y, -settings.k_lateral * z)
    speed = norm(velocity)
    if speed > settings.speed_max_mps:
        velocity = scaled(velocity, settings.speed_max_mps / speed)
    yaw_max = settings.yaw_rate_max_radps
    return Nominal(velocity, min(max(settings.k_yaw * error, -yaw_max), yaw_max))


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
