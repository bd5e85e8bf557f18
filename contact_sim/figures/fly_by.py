"""Cumulative detections over a flight past several targets, every picture through a service."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Final

import numpy as np

from contact_sim.figures.bench import FigureBench
from contact_sim.figures.fly_by_world import (
    FARTHEST_M,
    SEED,
    STATES,
    STEEPEST_RAD,
    FlyBy,
    Seeing,
    build_fly_by,
)
from contact_sim.figures.picture import AXES_WORDS, Studio, error_m, show
from contact_sim.figures.style import BLUE, GRAY, ORANGE, YELLOW, finish, legend, new_figure
from contact_sim.lockstep.eyes import Eyes
from contact_sim.sensing import d455
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import pose_of

RATE_HZ: Final = 10.0
QUICK_RATE_HZ: Final = 1.0
RIGHT_M: Final = 0.1
RIGHT_SHARE: Final = 0.05
"""An answer is right that is no farther from a board than this and this share of its range."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One picture: what was there, and what the service said."""

    t_s: float
    in_view: int | None
    """Number of the board that is in view as a whole."""
    in_part: bool
    """The centre of some board is in view, far or turned away or cut off as it may be."""
    found: int | None
    """Number of the board that the answer is about; None: it found none, or none that is there."""
    camera_from_target: Pose | None
    """The answer."""
    error_m: float | None
    """Of the answer, from that board."""

    @property
    def false(self) -> bool:
        """It found a target where none is."""
        return self.camera_from_target is not None and self.found is None


def draw(bench: FigureBench) -> tuple[Any, str]:
    """Count over time, and a picture of each board as the service saw it."""
    fly_by = build_fly_by(QUICK_RATE_HZ if bench.quick else RATE_HZ)
    sights, samples = _look(fly_by, bench.service, bench)
    figure = new_figure(5.6)
    grid = figure.add_gridspec(2, len(samples), height_ratios=(2.2, 1.0))
    axes = figure.add_subplot(grid[0, :])
    t_s = np.array([s.t_s for s in sights])
    right = np.cumsum([s.found is not None for s in sights])
    false = np.cumsum([s.false for s in sights])
    for part, alpha, name in (
        (True, 0.25, "in part, far or aside"),
        (False, 0.45, "a whole board in view"),
    ):
        for number, (start_s, end_s) in enumerate(stays(sights, part=part)):
            label = None if number else name
            axes.axvspan(start_s, end_s, color=YELLOW, alpha=alpha, lw=0, label=label)
    axes.step(t_s, right, where="post", color=BLUE, lw=1.8, label="targets found, in all")
    axes.step(t_s, false, where="post", color=ORANGE, lw=1.4, ls="--", label="found where none is")
    axes.plot(
        t_s, np.cumsum([s.in_view is not None for s in sights]), color=GRAY, lw=1.0, ls=":",
        label="pictures with a whole board",
    )  # fmt: skip
    axes.set_xlim(0.0, t_s[-1])
    finish(
        axes,
        f"detections during a flight past {len(fly_by.world_from_boards)} boards",
        "time [s]",
        "pictures, in all",
    )
    legend(axes, loc="upper left")
    for column, (number, (picture, pose)) in enumerate(sorted(samples.items())):
        sample = figure.add_subplot(grid[1, column])
        show(sample, picture, pose, d455().color, fly_by.target)
        sample.set_title(_board_name(number), fontsize=8)
    answered = sum(pose is not None for _, pose in samples.values())
    return figure, _caption(sights, fly_by, len(samples), answered)


def _look(
    fly_by: FlyBy, eyes: Eyes, bench: FigureBench
) -> tuple[list[Sight], dict[int, tuple[Any, Pose | None]]]:
    """Each picture, and one sample for each board: the middle one of its stay."""
    sights: list[Sight] = []
    pictures: dict[int, list[tuple[Any, Pose | None]]] = {}
    with Studio(fly_by.scene, SEED) as studio:
        seeing = Seeing(fly_by, studio.rig.color)
        for number, world_from_camera in enumerate(fly_by.way):
            t_ns = round(number * 1e9 / fly_by.rate_hz)
            picture = studio.take(t_ns, world_from_camera)
            look = eyes.look(studio.frame(picture), Pose.identity())
            answer = None if look.target is None else pose_of(look.target.camera_from_target)
            found, off_m = which(fly_by.world_from_boards, world_from_camera, answer)
            seen = seeing.whole(world_from_camera)
            in_part = seen is not None or seeing.partly(world_from_camera) is not None
            sights.append(Sight(t_ns / 1e9, seen, in_part, found, answer, off_m))
            if seen is not None:
                pictures.setdefault(seen, []).append((picture.color_rgb, answer))
            bench.tell("pictures of the fly-by", number + 1, len(fly_by.way))
    return sights, {board: taken[len(taken) // 2] for board, taken in pictures.items()}


def which(
    world_from_boards: Sequence[Pose], world_from_camera: Pose, answer: Pose | None
) -> tuple[int | None, float | None]:
    """The board that an answer is about, and how far it is off [m]; none where it is at no board.

    Args:
        world_from_boards: the truth.
        world_from_camera: the truth.
        answer: camera_from_target; None: none was found.
    """
    if answer is None:
        return None, None
    camera_from_world = world_from_camera.inverse()
    errors = [error_m(answer, camera_from_world @ board) for board in world_from_boards]
    nearest = int(np.argmin(errors))
    range_m = float(np.linalg.norm(answer.translation))
    if errors[nearest] > RIGHT_M + RIGHT_SHARE * range_m:
        return None, None
    return nearest, errors[nearest]


def stays(sights: Sequence[Sight], *, part: bool) -> list[tuple[float, float]]:
    """From when to when some board was in view [s], as a whole or at least in part."""
    period_s = sights[1].t_s - sights[0].t_s if len(sights) > 1 else 0.0
    found = []
    for is_seen, group in groupby(
        sights, key=lambda s: s.in_part if part else s.in_view is not None
    ):
        of_group = list(group)
        if is_seen:
            found.append((of_group[0].t_s, of_group[-1].t_s + period_s))
    return found


def _board_name(number: int) -> str:
    return "end of the tunnel" if number == 0 else f"board {number}, {STATES[number - 1]}"


def _caption(sights: Sequence[Sight], fly_by: FlyBy, shown: int, answered: int) -> str:
    whole = [s for s in sights if s.in_view is not None]
    part = [s for s in sights if s.in_part and s.in_view is None]
    none = [s for s in sights if not s.in_part]
    hits = [sum(s.found is not None for s in of) for of in (whole, part, none)]
    false = sum(s.false for s in sights)
    aside_deg = math.degrees(STEEPEST_RAD)
    errors_mm = [1e3 * s.error_m for s in sights if s.error_m is not None]
    off = ""
    if errors_mm:
        off = f" Median error {np.median(errors_mm):.1f} mm, worst {max(errors_mm):.0f} mm."
    return (
        f"A camera goes past {len(fly_by.world_from_boards)} boards in a tunnel (seed {SEED}), "
        f"each of its {len(sights)} pictures through a real service. Of {len(whole)} pictures with "
        f"a whole board in view (at most {FARTHEST_M:g} m away and {aside_deg:.0f} degrees "
        f"aside) {hits[0]} gave the pose of one, of {len(part)} with one that is cut off, farther "
        f"or more aside {hits[1]}, of the {len(none)} others {hits[2]}. Poses that are at no "
        f"board: {false}.{off} Below, one picture of each of {shown} boards, {answered} of them "
        f"with the pose that was answered, its axes: {AXES_WORDS}."
    )
