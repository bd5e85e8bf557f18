"""What the parts of a run need, out of the client's settings: every bound is stated once, there."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field, replace

from drone_client.cbf.settings import FilterSettings
from drone_client.control import ControlSettings
from drone_client.gate import GateSettings
from drone_client.odometry.jump import JumpSettings
from drone_client.odometry.lidar import LidarSettings
from drone_client.rate_control import RateSettings
from drone_client.settings import NS_PER_MS, ClientSettings
from drone_client.target import USUAL_BUDGET, OdometryBudget
from drone_client.uplink import UplinkSettings
from target_pose.target import Target, load_round_target, load_target


@dataclass(frozen=True, slots=True)
class OwnEyesSettings:
    """The drone's own eyes, for the moments without a link."""

    target: Target
    alone_max_ns: int
    """So long after the edge's last word no further look is taken."""


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """How far what the drone knows of its own place is believed (docs/odometry.md)."""

    budget: OdometryBudget = USUAL_BUDGET
    jump: JumpSettings = field(default_factory=JumpSettings)
    """Of the autopilot's own estimate, which the drone flies by."""
    vio_jump: JumpSettings = field(default_factory=JumpSettings)
    """Of the robot's VIO, before the autopilot gets it."""
    lidar: LidarSettings = field(default_factory=LidarSettings)


@dataclass(frozen=True, slots=True)
class FlightSettings:
    """All that the parts of a run need."""

    uplink: UplinkSettings
    gate: GateSettings
    control: ControlSettings
    rate: RateSettings
    reply_timeout_ns: int
    own_eyes: OwnEyesSettings | None = None
    """None: without the edge the drone is blind."""
    odometry: OdometrySettings = field(default_factory=OdometrySettings)


def flight_settings(settings: ClientSettings) -> FlightSettings:
    """The parts' settings out of the client's: every bound is stated once, in ``settings``.

    Raises:
        TargetFileError: the target cannot be read, or the drone's own eyes cannot look for it.
    """
    control = ControlSettings(
        filter=replace(
            FilterSettings().with_age_max(settings.gate.age_max_ns),
            period_s=1.0 / settings.control_hz,
            unconfirmed_mps=settings.onboard_growth_mm_s / 1e3,
        )
    )
    own_eyes = None
    if settings.onboard_fallback:
        alone_max_ns = round(settings.onboard_max_s * 1e9)
        own_eyes = OwnEyesSettings(load_round_target(settings.onboard_target), alone_max_ns)
    else:
        load_target(settings.onboard_target)  # what is flown to is drawn from it all the same
    return FlightSettings(
        uplink=UplinkSettings(
            drone=settings.name,
            boot_id=secrets.randbits(63),
            window=settings.window,
            ack_timeout_ns=round(settings.ack_timeout_ms * NS_PER_MS),
            age_max_ns=settings.gate.age_max_ns,
            hedge=settings.hedge,
        ),
        gate=settings.gate,
        rate=RateSettings(
            serialisation_max_ns=settings.gate.tau_max_ns // 3,
            enabled=settings.rate_control,
            best_quality=settings.jpeg_quality,
        ),
        control=control,
        reply_timeout_ns=round(settings.reply_timeout_ms * NS_PER_MS),
        own_eyes=own_eyes,
    )
