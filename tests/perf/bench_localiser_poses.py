"""The poses of the localiser's bench and what a D455 sees of them: rendered once and kept.

A cell is a condition at a distance. A folder of the cache is keyed by cell, seed, print,
backgrounds and everything that makes the pictures; a larger count goes on where a smaller one
ended. The streams of chance are this bench's own: no data set and no other bench shares one,
whatever its seed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import zlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.backgrounds import Background
from detector_training.scenes import Library, generate
from detector_training.scenes.depth import SCALE_M, DepthNoise, measured, png_of, random_noise
from detector_training.scenes.geometry import true_depth
from detector_training.scenes.recipe import PLANS, Plan, Recipe
from detector_training.scenes.recording import d455
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.geometry import Pose, rotation_from_vector
from target_pose.target import DEFAULT_TARGET, load_target
from tests.perf.bench_detector_prints import OURS, PRINTS
from tests.perf.bench_detector_scenes import generator_version, printed_shape

STREAM = 6
"""Where data sets have 1 to 3 for their split, the detector's bench 4 and depth 5."""
_DEPTH, _GRAVITY = 1, 2
DISTANCES_M = (0.6, 1.2, 2.5, 4.0, 6.0)
TILT_DEG = (0.0, 65.0)
BLUR_PX = 1.6
LOW_LIGHT = 0.12
GRAVITY_SIGMA_RAD = math.radians(2.0)
"""About each axis: the drone's attitude, and a board hung by eye."""
CAMERA = RgbdCamera(d455().color, d455().color, SCALE_M, Pose.identity())
"""Depth is aligned to colour, as `detector_training scenes --depth d455` writes it."""

_SHARP = replace(
    PLANS[Recipe.NOMINAL],
    camera=CAMERA.color,
    tilt_deg=TILT_DEG,
    motion=(0.0, 0.15),
    defocus=(0.0, 0.04),
)
ACCURACY: dict[str, Plan] = {
    "nominal": replace(_SHARP, whole=True),
    "blur": replace(_SHARP, whole=True, soft_px=(BLUR_PX, BLUR_PX)),
    "low light": replace(
        _SHARP,
        whole=True,
        dark=1.0,
        dark_stops=(math.log2(LOW_LIGHT), math.log2(LOW_LIGHT)),
        dark_noise=1.0,  # so much less light is noise enough
    ),
}
"""Each at every one of ``DISTANCES_M``, the whole board in the picture."""
_NEAR = replace(_SHARP, distance_m=(0.5, 4.0))
OCCLUSION: dict[str, Plan] = {
    "arm": replace(_NEAR, arm=1.0),
    "obstruction": replace(_NEAR, occluder=1.0),
    "border": replace(_NEAR, cut=1.0),
    "flare": replace(_NEAR, flare=1.0),
    "glossy": replace(_NEAR, gloss=1.0, mirror=0.75),
    "scratched": replace(_NEAR, worn=PLANS[Recipe.SCRATCHED].worn),
    "close": replace(_SHARP, distance_m=None, board_px=(300.0, 620.0), cut=0.4),
}
"""What hides the target, cuts it or changes its edges."""


@dataclass(frozen=True)
class Cell:
    """Poses of one condition, at one distance or between two."""

    condition: str
    distance_m: float | None
    plan: Plan

    @property
    def name(self) -> str:
        """As in the tables."""
        if self.distance_m is None:
            return self.condition
        return f"{self.condition} {self.distance_m:g} m"


def accuracy_cells() -> list[Cell]:
    """Conditions by distances."""
    return [
        Cell(name, z, replace(plan, distance_m=(z, z)))
        for name, plan in ACCURACY.items()
        for z in DISTANCES_M
    ]


def occlusion_cells() -> list[Cell]:
    """One a case, its distances mixed."""
    return [Cell(name, None, plan) for name, plan in OCCLUSION.items()]


@dataclass(frozen=True, eq=False)
class View:
    """One frame and the truth about it."""

    color_rgb: NDArray[np.uint8]  # (480, 640, 3)
    depth_units: NDArray[np.uint16] | None  # (480, 640), aligned; only with our print
    camera_from_target: Pose
    board_xyxy: NDArray[np.float64]  # (4,) [px]
    up_camera: NDArray[np.float64]  # (3,)
    """The world's up as an attitude filter has it, ``GRAVITY_SIGMA_RAD`` off."""

    def shows(self, centre_px: tuple[float, float], tolerance: float) -> bool:
        """Whether a centre is that of the board, to a share of its projected side."""
        x0, y0, x1, y1 = self.board_xyxy
        side = math.sqrt((x1 - x0) * (y1 - y0))
        u, v = (self.camera_from_target.translation @ CAMERA.color.image_from_camera.T)[:2] / (
            self.camera_from_target.translation[2]
        )
        return math.hypot(centre_px[0] - u, centre_px[1] - v) <= tolerance * side


@dataclass(frozen=True)
class Album:
    """The pictures of a cell with one print on the board."""

    cell: Cell
    printed: str
    """A name of ``PRINTS``."""
    seed: int
    backgrounds: tuple[Background, ...]
    cache: Path

    def seed_of(self, index: int) -> tuple[int, ...]:
        """Source of all chance of one pose; the same for each print."""
        return (self.seed, STREAM, zlib.crc32(self.cell.name.encode()), index)

    @cached_property
    def folder(self) -> Path:
        """Where the pictures are kept; made when missing."""
        names = sorted(f"{b.source}/{b.path.name}" for b in self.backgrounds)
        parts = [
            generator_version(),
            repr(self.cell.plan),
            repr(DepthNoise()),
            str(self.seed),
            printed_shape(),
            *names,
        ]
        key = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
        folder = self.cache / f"{self.cell.name.replace(' ', '_')}-{self.printed}-{key}"
        for name in ("images", "depth", "labels"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        return folder

    def view(self, index: int) -> View | None:
        """A picture, from the cache or rendered into it; None where nothing of the board shows."""
        name = f"{index:06d}"
        label_file = self.folder / f"labels/{name}.json"
        if not label_file.exists():
            self._render(index, name, label_file)
        label: dict[str, Any] = json.loads(label_file.read_text())
        if label["camera_from_target"] is None:
            return None
        image = cv2.imread(str(self.folder / f"images/{name}.jpg"), cv2.IMREAD_COLOR_RGB)
        depth = None
        if self.printed == OURS:
            depth = cv2.imread(str(self.folder / f"depth/{name}.png"), cv2.IMREAD_UNCHANGED)
        pose = Pose.from_matrix(np.array(label["camera_from_target"]))
        rng = np.random.default_rng((*self.seed_of(index), _GRAVITY))
        tip = rotation_from_vector(rng.normal(0, GRAVITY_SIGMA_RAD, 3))
        return View(
            np.asarray(image, np.uint8),
            None if depth is None else np.asarray(depth, np.uint16),
            pose,
            np.array(label["board_xyxy"]),
            tip @ pose.rotation[:, 2],
        )

    def _render(self, index: int, name: str, label_file: Path) -> None:
        """Write the picture, its depth and, when these are whole, its label."""
        seed = self.seed_of(index)
        library, target = Library.of(self.backgrounds), load_target(DEFAULT_TARGET)
        scene = generate(
            seed, library, target, Recipe.NOMINAL, PRINTS[self.printed], self.cell.plan
        )
        (self.folder / f"images/{name}.jpg").write_bytes(scene.jpeg)
        if self.printed == OURS:
            rng = np.random.default_rng((*seed, _DEPTH))
            truth_m = true_depth(rng, scene.geometry)
            depth = measured(rng, truth_m, scene.camera.fx, random_noise(rng))
            (self.folder / f"depth/{name}.png").write_bytes(png_of(depth))
        label = {
            "camera_from_target": scene.view()["camera_from_target"],
            "board_xyxy": scene.boxes[0].xyxy if scene.boxes else None,
            "conditions": scene.conditions,
        }
        part = label_file.with_suffix(".part")
        part.write_text(json.dumps(label))
        os.replace(part, label_file)
