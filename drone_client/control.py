"""One control tick: what is known -> mission -> guidance -> safety filter -> velocity command.

Pure. Knowledge is looked at again on every tick: a result that was fresh when it came grows old
between two ticks, and the filter sees its age now. Without a mission the drone goes straight for
contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from drone_client.airframe import Airframe
from drone_client.autopilot import VelocityCommand
from drone_client.cbf.filter import FilterInput, SafeCommand, filter_command
from drone_client.cbf.freshness import freshness
from drone_client.cbf.keep_out import KeepOut, Rotation
from drone_client.cbf.settings import FilterSettings
from drone_client.cbf.vector import Vec3, cross, moved, scaled
from drone_client.guidance import TO_CONTACT, GuidanceSettings, guide, yaw_error_rad
from drone_client.mission import (
    Intent,
    MissionSettings,
    MissionState,
    Observation,
    Seen,
    Senses,
    Told,
    step,
)
from drone_client.target import Source, TargetEstimate
from rgbd_wire.geometry import Array, Pose, vec3


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
    """Mission, guidance and filter."""

    mission: MissionSettings = field(default_factory=MissionSettings)
    guidance: GuidanceSettings = field(default_factory=GuidanceSettings)
    filter: FilterSettings = field(default_factory=FilterSettings)
    keep_outs: tuple[KeepOut, ...] = ()
    """Planes that propellers and body stay clear of."""


@dataclass(frozen=True, slots=True)
class OnMission:
    """The mission at one tick: where it is, and what there is to notice beside the target.

    ``Decision.mission`` is the ``state`` of the next tick; whoever only asks what would be decided
    drops it.
    """

    state: MissionState
    senses: Senses = field(default_factory=Senses)


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
    mission: MissionState | None = None
    """Where the mission is now, with its transition in this tick; None: there is no mission."""
    intent: Intent | None = None
    """What the mission wanted of this tick, and whether it gives the vehicle back."""


def decide(
    now_ns: int,
    estimate: TargetEstimate | None,
    world_from_body: Pose | None,
    airframe: Airframe,
    settings: ControlSettings,
    mission: OnMission | None = None,
) -> Decision:
    """Decide on the command to fly until the next tick.

    Args:
        now_ns: drone's clock.
        estimate: where the target is believed to be; None: never seen.
        world_from_body: where the drone is now; None: it does not know.
        airframe: where the tip is.
        settings: mission, guidance and filter.
        mission: where the mission is; None: none, straight for contact.
    """
    scene = None
    if estimate is not None and world_from_body is not None:
        scene = _scene(estimate, world_from_body, airframe)
    state, intent = None, Intent(TO_CONTACT)
    if mission is not None:
        observation = _observe(now_ns, estimate, world_from_body, scene, settings, mission.senses)
        state, intent = step(mission.state, observation, settings.mission)

    # Where nothing may be flown by, the drone stands; a search turns meanwhile.
    command = VelocityCommand(np.zeros(3), intent.yaw_rate_radps, now_ns)
    told = Told()
    if estimate is None:
        state = _heard(state, told)
        return Decision(command, Known.NO_TARGET, None, None, None, mission=state, intent=intent)
    age_ns, unconfirmed_ns = now_ns - estimate.t_capture_ns, estimate.unconfirmed_ns(now_ns)
    known = Known.NO_POSE if scene is None else Known.TARGET
    safe = tip_target = None
    if scene is not None:
        tip_target = scene.tip_target
        if not intent.blind:
            wish = guide(scene.target_from_tip, settings.guidance, scene.up_target, intent.goal)
            safe = filter_command(
                FilterInput(
                    tip_target=tip_target,
                    velocity_tip_nominal_target=wish.velocity_tip_target,
                    yaw_rate_nominal_radps=wish.yaw_rate_radps,
                    lever_arm_target=scene.lever_arm_target,
                    up_target=scene.up_target,
                    age_ns=age_ns,
                    range_m=estimate.range_m,
                    sigma_m=estimate.seen_sigma_m,
                    unconfirmed_ns=unconfirmed_ns,
                    keep_outs=settings.keep_outs,
                    target_from_body=_rows(scene.target_from_body.rotation),
                    target_from_world=scene.target_from_world_rotation,
                    world_origin_target=scene.world_origin_target,
                ),
                settings.filter,
            )
            velocity_world = _turned_back(
                scene.target_from_world_rotation, safe.velocity_body_target
            )
            command = VelocityCommand(np.array(velocity_world), safe.yaw_rate_radps, now_ns)
            told = _told(safe, scene)
    state = _heard(state, told)
    return Decision(
        command, known, age_ns, safe, tip_target, estimate.source, unconfirmed_ns, state, intent
    )


class _Scene(NamedTuple):
    """Tip and body as the target sees them."""

    target_from_tip: Pose
    target_from_body: Pose
    world_origin_target: Vec3
    target_from_world_rotation: Rotation
    tip_target: Vec3
    tip_world: Vec3
    lever_arm_target: Vec3
    up_target: Vec3
    tip_ahead_m: float


def _scene(estimate: TargetEstimate, world_from_body: Pose, airframe: Airframe) -> _Scene:
    target_from_world = estimate.world_from_target.inverse()
    target_from_body = target_from_world @ world_from_body
    target_from_tip = target_from_body @ airframe.body_from_tip
    rotation = _rows(target_from_world.rotation)
    tip_target = vec3(target_from_tip.translation)
    return _Scene(
        target_from_tip,
        target_from_body,
        vec3(target_from_world.translation),
        rotation,
        tip_target,
        vec3(world_from_body @ airframe.body_from_tip.translation),
        moved(tip_target, vec3(target_from_body.translation), -1.0),
        (rotation[0][2], rotation[1][2], rotation[2][2]),
        float(airframe.body_from_tip.translation[0]),
    )


def _observe(
    now_ns: int,
    estimate: TargetEstimate | None,
    world_from_body: Pose | None,
    scene: _Scene | None,
    settings: ControlSettings,
    senses: Senses,
) -> Observation:
    """What the mission looks at."""
    seen = heading_rad = None
    if world_from_body is not None:
        forward_world = world_from_body.rotation[:, 0]
        heading_rad = math.atan2(forward_world[1], forward_world[0])
    if estimate is not None and scene is not None:
        age_ns = now_ns - estimate.t_capture_ns
        seen = Seen(
            tip_target=scene.tip_target,
            tip_world=scene.tip_world,
            axis_world=scene.target_from_world_rotation[0],
            yaw_error_rad=yaw_error_rad(
                vec3(scene.target_from_tip.rotation[:, 0]), scene.up_target
            ),
            age_ns=age_ns,
            freshness=freshness(age_ns, settings.filter),
            outliers=estimate.outliers,
            tip_ahead_m=scene.tip_ahead_m,
        )
    return Observation(now_ns, seen, world_from_body is not None, heading_rad, senses)


def _told(safe: SafeCommand, scene: _Scene) -> Told:
    """The filter's answer for the mission's next tick."""
    swing = cross(scene.up_target, scene.lever_arm_target)
    along_mps = safe.velocity_body_target[0] + safe.yaw_rate_radps * swing[0]
    return Told(safe.status, safe.delta_m, along_mps)


def stop_command(now_ns: int) -> VelocityCommand:
    """The command to stand still."""
    return VelocityCommand(np.zeros(3), 0.0, now_ns)


def _heard(state: MissionState | None, told: Told) -> MissionState | None:
    """The mission with the filter's answer for its next tick."""
    return None if state is None else replace(state, told=told)


def _rows(rotation: Array) -> Rotation:
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    return (a, b, c), (d, e, f), (g, h, i)


def _turned_back(b_from_a: Rotation, v_b: Vec3) -> Vec3:
    """A vector of ``b`` in ``a``."""
    return moved(moved(scaled(b_from_a[0], v_b[0]), b_from_a[1], v_b[1]), b_from_a[2], v_b[2])
