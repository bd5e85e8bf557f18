"""The printed target on its plate: clean, scratched by years of work, or under a glossy film."""

from __future__ import annotations

import copy
from functools import lru_cache

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from contact_sim.scene import SEEN_GROUP
from contact_sim.scene.shapes import Shape, add_shape, moved, panel
from contact_sim.scene.textures import Paint, add_bare_material
from rgbd_wire.geometry import Pose
from target_pose.target import Disc, Shade, Target

PRINT_PX = 2048
"""Side of the texture: 0.2 mm of a board of 400 mm, a fifth of a pixel from 0.45 m away."""
PLATE_M = 0.012
"""Thickness of the plate that carries the print."""
PRINT_M = 0.0002
"""Thickness of the sheet that is seen; the plate behind is what is touched."""
FILM_M = 0.0001
"""So far before the print its glossy film lies."""
FRICTION = (0.6, 0.005, 1e-4)
"""Of a painted plate: sliding, turning [m], rolling [m]."""
_ALBEDO = {Shade.BLACK: 0.055, Shade.WHITE: 0.80}
"""Ink is not quite black and paper not quite white."""


def print_texture(
    target: Target, board: str, rng: np.random.Generator, side_px: int = PRINT_PX
) -> NDArray[np.uint8]:
    """The board seen from the front, (N, N, 3) RGB; first row up, as sRGB-like levels."""
    albedo = _drawn(target.board_side_m, target.board_shade, target.discs, side_px)
    if board == "scratched":
        albedo = _worn(albedo, rng)
    levels = np.sqrt(albedo)  # the renderer's pictures are read as squares of light
    tint = np.array([1.0, 0.995, 0.97], np.float32)
    return np.asarray(np.rint(255 * levels[..., None] * tint).astype(np.uint8))


@lru_cache(maxsize=2)
def _drawn(
    side_m: float, shade: Shade, discs: tuple[Disc, ...], side_px: int
) -> NDArray[np.float32]:
    """Albedo (N, N) of a fresh print, its edges averaged over each texel; read only."""
    texel_m = side_m / side_px
    along = (np.arange(side_px, dtype=np.float32) + 0.5) * texel_m - side_m / 2
    radius = np.hypot(along[:, None], along[None, :])
    albedo = np.full((side_px, side_px), _ALBEDO[shade], np.float32)
    for disc in sorted(discs, key=lambda d: -d.diameter_m):
        covered = np.clip((disc.diameter_m / 2 - radius) / texel_m + 0.5, 0, 1)
        albedo += covered * (_ALBEDO[disc.shade] - albedo)
    albedo.flags.writeable = False  # the next world's board is the same print
    return albedo


def _worn(albedo: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """With scratches down to the plate, runs of rust, and a film of dirt that is not even."""
    n = albedo.shape[0]
    coarse = rng.standard_normal((7, 7)).astype(np.float32)
    dirt = np.clip(cv2.resize(coarse, (n, n), interpolation=cv2.INTER_CUBIC) * 0.12 + 0.12, 0, 0.4)
    albedo = albedo + dirt * (0.16 - albedo)
    marks = np.zeros((n, n), np.uint8)
    for _ in range(int(rng.integers(18, 40))):
        start = rng.uniform(0, n, 2)
        length, angle = n * rng.uniform(0.03, 0.4), rng.uniform(0, 2 * np.pi)
        bend = rng.normal(0, 0.06 * length, 2)
        along = np.linspace(0, 1, 12)[:, None]
        way = start + along * length * np.array([np.cos(angle), np.sin(angle)])
        way = way + 4 * along * (1 - along) * bend
        thick = max(1, round(n * rng.uniform(0.0005, 0.0035)))
        cv2.polylines(marks, [np.rint(way).astype(np.int32)], False, 255, thick, cv2.LINE_AA)
    for _ in range(int(rng.integers(2, 6))):  # chips of the paint
        middle = rng.uniform(0, n, 2)
        turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        reach = n * rng.uniform(0.004, 0.018) * rng.uniform(0.5, 1.2, 12)
        edge = middle + reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        cv2.fillPoly(marks, [np.rint(edge).astype(np.int32)], 255, cv2.LINE_AA)
    bare = np.float32(rng.uniform(0.2, 0.4))
    scraped = marks.astype(np.float32) / 255 * rng.uniform(0.6, 0.95)
    return np.asarray(albedo + scraped * (bare - albedo), dtype=np.float32)


def add_board(
    spec: mujoco.MjSpec,
    target: Target,
    board: str,
    world_from_target: Pose,
    rng: np.random.Generator,
) -> Paint:
    """Hang the board into the world: geom ``board``, a plate that can be touched, and its print.

    Returns what paints the material ``print``, with chances of ``rng``, which is its alone.
    """
    half = target.board_side_m / 2
    plate = world_from_target @ np.array([-PRINT_M - PLATE_M / 2, 0.0, 0.0])
    spec.add_material(name="plate", rgba=(0.35, 0.35, 0.36, 1.0))
    spec.worldbody.add_geom(
        name="board",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(PLATE_M / 2, half, half),
        pos=plate,
        quat=world_from_target.q_wxyz,
        friction=FRICTION,
        material="plate",
        group=SEEN_GROUP,
    )
    add_bare_material(spec, "print")
    add_shape(spec, "print", moved(_sheet(half, 0.0, cells=8), world_from_target), "print")
    if board == "glossy":
        # OpenGL's old lights multiply a highlight with the texture: black ink would not shine
        spec.add_material(name="film", rgba=(0.02, 0.02, 0.02, 0.25), specular=1.0, shininess=0.15)
        # and they shine on the corners of triangles alone: a highlight wants many
        film = moved(_sheet(half, FILM_M, cells=32), world_from_target)
        add_shape(spec, "film", film, "film")
    return lambda: print_texture(target, board, copy.deepcopy(rng))


def _sheet(half_m: float, x_m: float, cells: int) -> Shape:
    """A square in the frame ``target``, so far before the board, that shows its texture once."""
    return panel(
        np.array([x_m, -half_m, half_m]),
        np.array([0.0, 2 * half_m, 0.0]),
        np.array([0.0, 0.0, -2 * half_m]),
        tile_m=2 * half_m,
        cells=cells,
    )
