"""Samples of every condition, with the pose that a service answered drawn in."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_sim.figures.bench import FigureBench
from contact_sim.figures.picture import AXES_WORDS, Studio, camera_at, error_m, show
from contact_sim.figures.style import GRAY, ORANGE, new_figure
from contact_sim.lockstep.eyes import Eyes
from contact_sim.scene import Scene, build_scene
from contact_sim.sensing import d455
from drone_client.airframe import CAMERA_DOWN_RAD
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import pose_of
from target_pose.target import load_round_target

COLUMNS: Final = 3
SETTLE: Final = 3
"""Pictures before the one that counts: the exposure settles."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One sample."""

    name: str
    world: str
    seed: int
    board: str = "clean"
    away_m: float = 1.2
    aside_deg: float = 12.0
    """Where the camera is, to the left of the board's normal as it looks."""
    look_deg: float = 0.0
    """How far it looks to the left of the board."""
    down_deg: float = math.degrees(CAMERA_DOWN_RAD)
    above_m: float = 0.1
    lamps_out: bool = False
    over: float | None = None
    """How much more light than it wants the exposure lets in; None: as the world has it."""
    arm_m: float = 0.0


CONDITIONS: Final = (
    Condition("tunnel, clean", "tunnel", 3),
    Condition("tunnel, scratched", "tunnel", 5, "scratched", away_m=0.75, aside_deg=-15.0),
    Condition("tunnel, glossy", "tunnel", 8, "glossy", away_m=0.9, aside_deg=5.0),
    Condition("tunnel, all lamps out", "tunnel", 12, lamps_out=True, away_m=1.0),
    Condition(
        "tunnel, lamp in the lens",
        "tunnel",
        24,
        away_m=3.0,
        aside_deg=35.0,
        look_deg=25.0,
        down_deg=0.0,
    ),
    Condition("tunnel, far", "tunnel", 30, away_m=3.8, aside_deg=3.0),
    Condition("refinery, clean", "refinery", 13),
    Condition("refinery, scratched", "refinery", 18, "scratched", away_m=0.75, aside_deg=25.0),
    Condition("refinery, glossy", "refinery", 7, "glossy", away_m=0.9),
    Condition("refinery, over-exposed", "refinery", 20, over=6.0),
    Condition(
        "refinery, sun in the lens",
        "refinery",
        1,
        away_m=3.0,
        aside_deg=15.0,
        look_deg=-10.0,
        down_deg=-5.0,
    ),
    Condition("arm before the board", "refinery", 2, away_m=0.45, aside_deg=0.0),
)


class Sample(NamedTuple):
    """A condition as it was seen."""

    condition: Condition
    color_rgb: NDArray[np.uint8]
    answer: Pose | None
    """camera_from_target."""
    why: str
    """What the service said instead."""
    error_m: float | None


def draw(bench: FigureBench) -> tuple[Any, str]:
    """A sheet of pictures."""
    chosen = CONDITIONS[:2] if bench.quick else CONDITIONS
    samples = []
    for condition in chosen:
        samples.append(take(condition, bench.service))
        bench.tell("samples of the conditions", len(samples), len(chosen))
    rows = math.ceil(len(samples) / COLUMNS)
    figure = new_figure(2.17 * rows)
    panels = figure.subplots(rows, COLUMNS, squeeze=False)
    target, i = load_round_target(), d455().color
    for axes, sample in zip(panels.flat, samples, strict=False):
        show(axes, sample.color_rgb, sample.answer, i, target)
        axes.set_title(sample.condition.name, fontsize=9, pad=3)
        words, color = _words(sample)
        axes.text(
            0.02, 0.03, words, transform=axes.transAxes, fontsize=8, color="white",
            bbox={"facecolor": color, "alpha": 0.75, "lw": 0, "pad": 2},
        )  # fmt: skip
    for axes in list(panels.flat)[len(samples) :]:
        axes.set_axis_off()
    return figure, _caption(samples)


def camera_of(condition: Condition, scene: Scene) -> Pose:
    """``world_from_camera`` of a condition: it looks at the board, but for what it is told."""
    aside = math.radians(condition.aside_deg)
    # the left of who looks at the board is its -y
    flat = condition.away_m * np.array([math.cos(aside), -math.sin(aside), 0.0])
    place = scene.world_from_target @ flat + np.array([0.0, 0.0, condition.above_m])
    way = scene.world_from_target.translation - place
    heading = math.atan2(way[1], way[0]) + math.radians(condition.look_deg)
    return camera_at(place, heading, math.radians(condition.down_deg))


def take(condition: Condition, eyes: Eyes) -> Sample:
    """Draw the picture, and ask the service."""
    scene = build_scene(condition.world, condition.seed, condition.board)
    light = scene.light
    if condition.over is not None:
        light = replace(light, over=condition.over)
    world_from_camera = camera_of(condition, scene)
    out = frozenset(scene.lamps) if condition.lamps_out else frozenset()
    with Studio(scene, condition.seed, light) as studio:
        for number in range(SETTLE + 1):
            picture = studio.take(number * 66_666_667, world_from_camera, out, condition.arm_m)
        look = eyes.look(studio.frame(picture), Pose.identity())
    if look.target is None:
        return Sample(
            condition, picture.color_rgb, None, look.outcome.value.replace("_", " "), None
        )
    answer = pose_of(look.target.camera_from_target)
    truth = picture.world_from_camera.inverse() @ scene.world_from_target
    return Sample(condition, picture.color_rgb, answer, "", error_m(answer, truth))


def _words(sample: Sample) -> tuple[str, str]:
    if sample.answer is None or sample.error_m is None:
        return sample.why, ORANGE
    away_m = float(np.linalg.norm(sample.answer.translation))
    return f"{away_m:.2f} m, off by {1e3 * sample.error_m:.1f} mm", GRAY


def _caption(samples: list[Sample]) -> str:
    errors = [s.error_m for s in samples if s.error_m is not None]
    missed = [s.condition.name for s in samples if s.error_m is None]
    words = f"Not found: {', '.join(missed)}. " if missed else ""
    worst = f" The worst place is off by {1e3 * max(errors):.1f} mm." if errors else ""
    return (
        f"One sample of each of {len(samples)} conditions, as the drone's camera gives it, "
        f"through a real service: {len(errors)} of {len(samples)} found.{worst} {words}Drawn in: "
        "edge and circles of the target where the answer says it is, and its axes: "
        f"{AXES_WORDS}. The errors count the camera's own, whose lens is not quite what its "
        "calibration says."
    )
