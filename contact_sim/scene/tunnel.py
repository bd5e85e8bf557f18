"""A tunnel: dark, rough, dusty; the board hangs on the working face or on a side wall."""

from __future__ import annotations

import math
from itertools import pairwise

import mujoco
import numpy as np

from contact_sim.chance import stream
from contact_sim.scene import Lamp, Light, Scene, shapes, textures
from contact_sim.scene.board import add_board
from contact_sim.scene.lamps import add_lamp, light_from_all_sides
from contact_sim.scene.parts import Parts
from contact_sim.scene.shapes import seen_from
from contact_sim.scene.site import CLEAR_M, Site, draw_site, draw_wind
from contact_sim.scene.textures import Paint
from rgbd_wire.geometry import Array, Pose, rotation_from_vector
from target_pose.target import load_round_target

LENGTH_M = 14.0
RAIL_M = 0.09
"""Height of the rails above the floor."""
_VENTILATION_MPS = 1.0
_TILE_M = 1.6
_ACROSS, _ALONG = 44, 52


class _Tube:
    """The tunnel's hollow in its own frame: x along it from the face, z up, y to the left."""

    def __init__(self, rng: np.random.Generator, width_m: float) -> None:
        self.width_m = width_m
        self.wall_m = float(rng.uniform(2.2, 2.5))
        """Height at which the vault begins."""
        self.height_m = self.wall_m + float(rng.uniform(0.8, 1.5))
        self.slope = float(rng.uniform(-0.03, 0.03))
        self.rough_m = float(rng.uniform(0.04, 0.11))

    def profile(self) -> Array:
        """The cross-section (N, 2) as (y, z), from the right foot over the vault to the left."""
        half, rise = self.width_m / 2, self.height_m - self.wall_m
        turn = np.linspace(0, math.pi, 200)
        vault = np.column_stack([-half * np.cos(turn), self.wall_m + rise * np.sin(turn)])
        way = np.vstack([[-half, -0.3], vault, [half, -0.3]])
        lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
        at = np.linspace(0, lengths[-1], _ACROSS)
        return np.column_stack([np.interp(at, lengths, way[:, i]) for i in (0, 1)])

    def floor_m(self, x_m: float) -> float:
        """Height of the floor so far from the face."""
        return self.slope * x_m


def build_tunnel(seed: int, board: str) -> Scene:
    """The tunnel of a seed."""
    rng = stream(seed, "tunnel")
    on_face = bool(rng.random() < 0.6)
    width = float(rng.uniform(3.8, 5.2) if on_face else rng.uniform(4.8, 6.0))
    tube = _Tube(rng, width)
    aside = float(rng.uniform(-0.35, 0.35))
    if on_face:
        site = draw_site(rng, 3.5, width / 2 - abs(aside) - 0.9)
        site_from_tube = Pose(np.array([0.0, aside, 0.0]), Pose.identity().q_wxyz)
    else:
        site = draw_site(rng, min(3.5, width - 1.6), 1.0)
        quarter = rotation_from_vector(np.array([0.0, 0.0, math.pi / 2]))
        down_the_tube = -float(rng.uniform(4.0, 7.0))
        site_from_tube = Pose.from_rotation(quarter, np.array([width / 2, down_the_tube, 0.0]))
    board_x = 0.0 if on_face else -site_from_tube.translation[1]
    level = tube.floor_m(board_x)
    site_from_tube = Pose(site_from_tube.translation - (0, 0, level), site_from_tube.q_wxyz)

    spec = mujoco.MjSpec()
    spec.modelname = "tunnel"
    world_from_tube = site.world_from_site @ site_from_tube
    parts = Parts(spec, world_from_tube)
    paints = _add_rock(parts, rng, tube, site_from_tube, site)
    _add_solids(parts, tube)
    paints |= _add_fittings(parts, rng, tube, site_from_tube, site)
    parts.draw()
    paints |= _add_plate(spec, rng, site)
    paints["print"] = add_board(
        spec, load_round_target(), board, site.world_from_target, stream(seed, f"print {board}")
    )
    light_from_all_sides(spec, float(rng.uniform(0.05, 0.09)))
    lamps = _add_lamps(spec, rng, tube, world_from_tube, board_x)
    near = [tube.floor_m((site_from_tube.inverse() @ p)[0]) for p in _way(site)]
    along_tube = world_from_tube.rotation[:, 0]
    wind_world = draw_wind(seed, along_tube, _VENTILATION_MPS, 0.0)
    level_site = site_from_tube.translation[2]
    facts = {
        **site.facts,
        "board": board,
        "wall": "face" if on_face else "side",
        "width_m": width,
        "height_m": tube.height_m,
        "slope": tube.slope,
        "lamps": len(lamps),
        "wind_mps": math.hypot(*wind_world),
    }
    haze = float(rng.uniform(0.01, 0.07))
    return Scene(
        spec,
        "tunnel",
        seed,
        site.world_from_target,
        site.world_from_body,
        floor_m=max(near) + level_site + RAIL_M,
        ceiling_m=min(near) + level_site + tube.wall_m,
        lamps=tuple(lamp.name for lamp in lamps),
        light=Light(
            level=float(rng.uniform(0.25, 0.9)),
            haze_per_m=haze,
            haze_rgb=(0.22, 0.20, 0.17),
            dust=float(rng.uniform(5, 40)),
            projector=1.0,
            lamps=tuple(lamps),
        ),
        facts=facts,
        paints=paints,
        wind_world=wind_world,
    )


def _way(site: Site) -> tuple[Array, Array]:
    return site.site_from_target.translation, site.site_from_body.translation


def _add_rock(
    parts: Parts, rng: np.random.Generator, tube: _Tube, site_from_tube: Pose, site: Site
) -> dict[str, Paint]:
    """Vault, face and floor, rough but for where the board hangs; returns what paints them."""
    paints = {"rock": textures.rock(rng), "ground": textures.gravel(rng)}
    inside = np.array([LENGTH_M / 2, 0.0, 1.0])
    profile = tube.profile()
    along = np.linspace(-0.4, LENGTH_M, _ALONG)
    vault = np.empty((_ACROSS, _ALONG, 3))
    vault[..., 0] = along
    vault[..., 1:] = profile[:, None]
    vault[..., 2] += tube.slope * along
    tangent = np.gradient(profile, axis=0)
    inwards = np.column_stack([0 * tangent[:, 0], tangent[:, 1], -tangent[:, 0]])
    inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
    relief = tube.rough_m * textures.cloud(rng, 64, 1.3)[:_ACROSS, :_ALONG].astype(float)
    vault += _flat_near(relief, site_from_tube @ vault, site)[..., None] * inwards[:, None]
    lengths = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    spans = np.concatenate([[0], np.cumsum(lengths)])
    texture = np.stack(np.broadcast_arrays(along, spans[:, None]), -1) / _TILE_M
    tube_shape = seen_from(inside, shapes.grid(vault, texture))

    n = 30
    y = np.linspace(tube.width_m / 2 + 0.4, -tube.width_m / 2 - 0.4, n)
    z = np.linspace(tube.height_m + 0.3, -0.3, n)
    face = np.zeros((n, n, 3))
    face[..., 1], face[..., 2] = y[None, :], z[:, None]
    relief = tube.rough_m * textures.cloud(rng, 32, 1.3)[:n, :n].astype(float)
    face[..., 0] = _flat_near(relief, site_from_tube @ face, site)
    texture = np.stack(np.broadcast_arrays(y[None, :], -z[:, None]), -1) / _TILE_M
    face_shape = seen_from(inside, shapes.grid(face, texture))
    parts.add("rock", tube_shape, face_shape)

    x = np.linspace(-0.5, LENGTH_M, 40)
    y = np.linspace(-tube.width_m / 2 - 0.3, tube.width_m / 2 + 0.3, 16)
    floor = np.empty((40, 16, 3))
    floor[..., 0], floor[..., 1] = x[:, None], y[None, :]
    bumps = 0.012 * textures.cloud(rng, 64, 1.4)[:40, :16]
    floor[..., 2] = tube.slope * x[:, None] + np.clip(bumps, -0.03, 0.03)
    texture = np.stack(np.broadcast_arrays(y[None, :], x[:, None]), -1) / 1.2
    parts.add("ground", seen_from(inside, shapes.grid(floor, texture)))
    return paints


def _flat_near(relief: Array, points_site: Array, site: Site) -> Array:
    """The relief (m, n) [m], inwards, without what would stand beside the board."""
    board = site.site_from_target.translation
    away = np.linalg.norm(points_site - board, axis=-1)
    share = np.clip((away - CLEAR_M) / 0.8, 0.0, 1.0)
    return np.asarray(relief * share**2 * (3 - 2 * share))


def _add_solids(parts: Parts, tube: _Tube) -> None:
    """What can be touched of the rock: slabs all round, behind its mean surface."""
    thick, length = 0.4, LENGTH_M + 1.0
    pitch = rotation_from_vector(np.array([0.0, -math.atan(tube.slope), 0.0]))
    profile = tube.profile()
    corners = [*profile[:-1:4], profile[-1]]
    for a, b in pairwise(corners):
        edge = b - a
        span = float(np.linalg.norm(edge))
        normal = np.array([edge[1], -edge[0]]) / span  # inwards
        middle = (a + b) / 2 - normal * thick / 2
        turn = rotation_from_vector(np.array([math.atan2(normal[1], normal[0]), 0.0, 0.0]))
        center = (LENGTH_M / 2, middle[0], middle[1] + tube.slope * LENGTH_M / 2)
        parts.solid_box("rock", center, (length, thick, span + 0.1), pitch @ turn)
    face = (-thick / 2, 0.0, tube.height_m / 2)
    parts.solid_box("rock", face, (thick, tube.width_m + 1, tube.height_m + 1))
    floor = (LENGTH_M / 2, 0.0, tube.slope * LENGTH_M / 2 - thick / 2)
    parts.solid_box("ground", floor, (length, tube.width_m + 1, thick), pitch)


def _add_fittings(
    parts: Parts, rng: np.random.Generator, tube: _Tube, site_from_tube: Pose, site: Site
) -> dict[str, Paint]:
    """Rails, a duct under the vault, cables and pipes along the walls, and what was left there.

    Returns what paints them.
    """
    half, pitch = tube.width_m / 2, np.array([1.0, 0.0, tube.slope])
    start, end = 0.7, LENGTH_M - 0.2

    def line(look: str, y: float, z: float, radius: float) -> None:
        a, b = start * pitch + (0, y, z), end * pitch + (0, y, z)
        parts.rod(look, a, b, radius, 0.8)

    for y in (-0.45, 0.45):
        line("steel", y, RAIL_M - 0.035, 0.035)
    for x in np.arange(start, end, 0.8):
        parts.block("dark", (x, 0.0, tube.floor_m(x) + 0.02), (0.2, 1.3, 0.06), 0.8)
    duct = float(rng.uniform(0.2, 0.3))
    duct_y = float(rng.choice((-1, 1))) * 0.25 * half
    line("paint", duct_y, tube.height_m - duct - 0.1, duct)
    for side in (-1, 1):
        low = rng.uniform(0.25, 0.6)
        for k in range(int(rng.integers(1, 4))):
            line("dark", side * (half - 0.08), tube.wall_m - 0.15 + 0.09 * k, 0.022)
        if rng.random() < 0.7:
            line("steel", side * (half - 0.12), low, rng.uniform(0.04, 0.08))
    _add_clutter(parts, rng, tube, site_from_tube, site)
    return {
        "steel": textures.painted_steel(rng, (0.25, 0.24, 0.23)),
        "dark": textures.painted_steel(rng, (0.05, 0.045, 0.04)),
        "paint": textures.painted_steel(rng, _paint(rng)),
    }


def _add_clutter(
    parts: Parts, rng: np.random.Generator, tube: _Tube, site_from_tube: Pose, site: Site
) -> None:
    """Crates and drums along the walls, clear of where the drone flies."""
    way = np.array([p[:2] for p in _way(site)])
    for _ in range(int(rng.integers(3, 9))):
        x, side = rng.uniform(0.5, LENGTH_M - 1), float(rng.choice((-1, 1)))
        y = side * (tube.width_m / 2 - rng.uniform(0.35, 0.6))
        height, floor = float(rng.uniform(0.3, 0.9)), tube.floor_m(x)
        place = (site_from_tube @ np.array([x, y, 0.0]))[:2]
        if _distance(place, way) < 1.2:
            continue
        if rng.random() < 0.5:
            parts.rod("paint", (x, y, floor), (x, y, floor + height), 0.28, 0.8)
        else:
            size = (rng.uniform(0.3, 0.8), 0.45, height)
            parts.block("dark", (x, y, floor + height / 2), size, 0.8)


def _distance(place: Array, way: Array) -> float:
    """From a place (2,) to the straight way between two others (2, 2)."""
    a, b = way
    share = np.clip((place - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return float(np.linalg.norm(a + share * (b - a) - place))


def _add_plate(spec: mujoco.MjSpec, rng: np.random.Generator, site: Site) -> dict[str, Paint]:
    """What carries the board: a bracket between it and the rock, a little larger than nothing.

    Returns what paints it.
    """
    parts = Parts(spec, site.world_from_site)
    off = site.site_from_target.translation
    for y in (-0.12, 0.12):
        parts.block("bracket", (off[0] / 2 - 0.03, y, off[2]), (off[0], 0.04, 0.3), 0.5)
    parts.draw()
    return {"bracket": textures.painted_steel(rng, (0.3, 0.3, 0.3))}


def _add_lamps(
    spec: mujoco.MjSpec,
    rng: np.random.Generator,
    tube: _Tube,
    world_from_tube: Pose,
    board_x_m: float,
) -> list[Lamp]:
    """A row of lamps on one wall, now and then one that is broken; one is never far from the board.

    OpenGL's old lights are eight at most.
    """
    lamps = []
    side = float(rng.choice((-1, 1)))
    gap = rng.uniform(2.2, 3.4)
    first = max(board_x_m, 0.0) + rng.uniform(0.9, 1.7)
    while first - gap > 0.5:
        first -= gap
    for i, x in enumerate(np.arange(first, LENGTH_M, gap)[:6]):
        near = abs(x - board_x_m) < 0.6 * gap
        if not near and rng.random() < 0.2:
            continue
        at = np.array([x, side * (tube.width_m / 2 - 0.15), tube.floor_m(x) + tube.wall_m + 0.1])
        size = np.array([0.34, 0.08, 0.12])
        power = float(rng.uniform(0.75, 1.1))
        lamps.append(add_lamp(spec, world_from_tube, at, size, f"lamp_{i}", power))
    return lamps


def _paint(rng: np.random.Generator) -> tuple[float, float, float]:
    colours = ((0.45, 0.30, 0.03), (0.05, 0.14, 0.30), (0.30, 0.04, 0.03), (0.2, 0.22, 0.2))
    return colours[int(rng.integers(len(colours)))]
