"""One control tick: what is known -> guidance -> safety filter -> velocity command.

Pure. Knowledge is looked at again on every tick: a result that was fresh when it came grows old
between two ticks, and the filter sees its age now.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from drone_client.airframe import Airframe
from drone_client.autopilot import VelocityCommand
from drone_client.cbf.filter import FilterInput, SafeCommand, filter_command
from drone_client.cbf.settings import FilterSettings
from drone_client.cbf.vector import Vec3
from drone_client.guidance import GuidanceSettings, guide
from drone_client.target import Source, TargetEstimate
from rgbd_wire.geometry import Array, Pose

UP_WORLD = np.array([0.0, 0.0, 1.0])


class Known(StrEnum):
    """Whether there is anything to fly on."""

    TARGET = "target"
    """Both poses; how old the target is, is the filter's business."""
    NO_TARGET = "no_target"
    """Never seen: stop."""
    NO_POSE = "no_pose"
    """The drone does not know where it is: stop."""


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """Guidance and filter."""

    guidance: GuidanceSettings = field(default_factory=GuidanceSettings)
    filter: FilterSettings = field(default_factory=FilterSettings)


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """What one tick decided, and on what."""

    command: VelocityCommand
    known: Known
    age_ns: int | None
    """Since the exposure of the newest measurement in the estimate; None: no target."""
    safe: SafeCommand | None
    """What the filter said; None where there was nothing to ask it about."""
    tip_target: Vec3 | None
    """Tip in the target's frame [m]."""
    source: Source | None = None
    """Whose eyes the target was seen with; None: no target."""
    unconfirmed_ns: int = 0
    """How long the drone has been the only one to see it; 0: the edge's own word."""


def decide(
    now_ns: int,
    estimate: TargetEstimate | None,
    world_from_body: Pose | None,
    airframe: Airframe,
    settings: ControlSettings,
) -> Decision:
    """Decide on the command to fly until the next tick.

    Args:
        now_ns: drone's clock.
        estimate: where the target is believed to be; None: never seen.
        world_from_body: where the drone is now; None: it does not know.
        airframe: where the tip is.
        settings: guidance and filter.
    """
    if estimate is None:
        return Decision(stop_command(now_ns), Known.NO_TARGET, None, None, None)
    age_ns = now_ns - estimate.t_capture_ns
    if world_from_body is None:
        return Decision(stop_command(now_ns), Known.NO_POSE, age_ns, None, None, estimate.source)

    target_from_world = estimate.world_from_target.inverse()
    target_from_body = target_from_world @ world_from_body
    target_from_tip = target_from_body @ airframe.body_from_tip
    target_from_world_rotation = target_from_world.rotation
    tip_target = _vec3(target_from_tip.translation)
    up_target = _vec3(target_from_world_rotation @ UP_WORLD)
    nominal = guide(target_from_tip, settings.guidance, up_target)
    unconfirmed_ns = estimate.unconfirmed_ns(now_ns)
    safe = filter_command(
        FilterInput(
            tip_target=tip_target,
            velocity_tip_nominal_target=nominal.velocity_tip_target,
            yaw_rate_nominal_radps=nominal.yaw_rate_radps,
            lever_arm_target=_vec3(target_from_tip.translation - target_from_body.translation),
            up_target=up_target,
            age_ns=age_ns,
            range_m=estimate.range_m,
            sigma_m=estimate.seen_sigma_m,
            unconfirmed_ns=unconfirmed_ns,
        ),
        settings.filter,
    )
    velocity_world = target_from_world_rotation.T @ np.array(safe.velocity_body_target)
    command = VelocityCommand(velocity_world, safe.yaw_rate_radps, now_ns)
    return Decision(
        command, Known.TARGET, age_ns, safe, tip_target, estimate.source, unconfirmed_ns
    )


def stop_command(now_ns: int) -> VelocityCommand:
    """The command to stand still."""
    return VelocityCommand(np.zeros(3), 0.0, now_ns)


def _vec3(v: Array) -> Vec3:
    x, y, z = v.tolist()
    return x, y, z
