"""A refinery: tanks, pipes, flanges, gratings; sunlight that over-exposes, or blinds the camera."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from contact_sim.chance import stream
from contact_sim.scene import Light, Scene, Sun, shapes, textures
from contact_sim.scene.board import add_board
from contact_sim.scene.lamps import light_from_all_sides
from contact_sim.scene.parts import Parts
from contact_sim.scene.shapes import Shape, seen_from
from contact_sim.scene.site import CLEAR_M, Site, draw_site, draw_wind
from contact_sim.scene.textures import Paint
from rgbd_wire.geometry import Array
from target_pose.target import load_round_target

_HALF_M = 7.0
"""Half the width of the wall, or the share of the tank's skin that is built."""
_SIDE_CLEAR_M = 1.15
"""So far to the sides of the board nothing stands before the wall."""
GRATING_M = 0.02
"""Height of the walkway above the ground."""
_WIND_MPS = 2.0
_SHINING = frozenset({"pipe", "steel", "handle"})


def build_refinery(seed: int, board: str) -> Scene:
    """The refinery of a seed."""
    rng = stream(seed, "refinery")
    site = draw_site(rng, 3.5, 1.2)
    spec = mujoco.MjSpec()
    spec.modelname = "refinery"
    parts = Parts(spec, site.world_from_site)
    sun_site, sun_level = _draw_sun(rng)
    on_tank = bool(rng.random() < 0.4)
    radius = float(rng.uniform(4.0, 7.0)) if on_tank else math.inf
    if on_tank:
        _add_tank_wall(parts, rng, radius)
    else:
        _add_hall_wall(parts, rng)
    _add_pipes(parts, rng, site)
    _add_columns(parts, rng)
    _add_instruments(parts, rng, radius)
    _add_yard(parts, rng)

    looks = _looks(rng)
    parts.draw(_SHINING)
    print_chance = stream(seed, f"print {board}")
    painted_print = add_board(
        spec, load_round_target(), board, site.world_from_target, print_chance
    )

    light_from_all_sides(spec, float(rng.uniform(0.34, 0.46)))
    sun_world = site.world_from_site.rotation @ sun_site
    white = sun_level * np.array([1.0, 0.97, 0.9])
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=site.world_from_site @ np.array([0.0, 0.0, 30.0]),
        dir=-sun_world,
        diffuse=white,
        specular=1.5 * white,
        castshadow=0,
    )
    _add_sky(spec, rng)
    along_wall = site.world_from_site.rotation[:, 1]
    wind_world = draw_wind(seed, along_wall, _WIND_MPS, math.radians(40))
    over = float(np.exp(rng.uniform(0.0, np.log(3.5))))
    facts = {
        **site.facts,
        "board": board,
        "over_exposed": over,
        "wall": f"tank of {radius:.1f} m" if on_tank else "hall",
        "wind_mps": math.hypot(*wind_world),
        "sun_elevation_deg": math.degrees(math.asin(sun_site[2])),
        "sun_from_front_deg": math.degrees(math.acos(np.clip(sun_site[0], -1, 1))),
    }
    return Scene(
        spec,
        "refinery",
        seed,
        site.world_from_target,
        site.world_from_body,
        floor_m=GRATING_M,
        ceiling_m=None,
        lamps=(),
        light=Light(
            level=float(rng.uniform(4.0, 9.0)),
            haze_per_m=float(rng.uniform(0.001, 0.006)),
            haze_rgb=(0.74, 0.76, 0.80),
            dust=0.0,
            projector=0.12,
            over=over,
            sun=Sun(sun_world, strength=float(rng.uniform(1.5, 3.0))),
        ),
        facts=facts,
        paints={**{name: looks[name] for name in parts.by_look}, "print": painted_print},
        wind_world=wind_world,
    )


def _draw_sun(rng: np.random.Generator) -> tuple[Array, float]:
    """Unit vector (3,) to the sun in the site, and its level; it may stand behind the wall."""
    elevation = math.radians(rng.uniform(18, 60))
    azimuth = math.radians(rng.uniform(-75, 75))
    if rng.random() < 0.3:  # behind the wall: the board in its shade, the sun in the camera
        azimuth += math.pi
    flat = math.cos(elevation)
    towards = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
    return towards, float(rng.uniform(0.55, 0.75))


def _looks(rng: np.random.Generator) -> dict[str, Paint]:
    hues = ((0.45, 0.45, 0.43), (0.10, 0.20, 0.12), (0.38, 0.30, 0.10), (0.12, 0.20, 0.34))
    first, second = (hues[i] for i in rng.permutation(len(hues))[:2])
    return {
        "wall": textures.cladding(rng) if rng.random() < 0.6 else textures.concrete(rng),
        "pipe": textures.painted_steel(rng, first),
        "cladded": textures.cladding(rng),
        "steel": textures.painted_steel(rng, second),
        "handle": textures.painted_steel(rng, (0.40, 0.04, 0.03)),
        "grating": textures.grating(rng),
        "ground": textures.concrete(rng),
        "dial": textures.dial(rng),
        "sign": textures.sign(rng),
    }


def _add_hall_wall(parts: Parts, rng: np.random.Generator) -> None:
    """A straight wall with a plinth, not so high that the sky is never seen above."""
    height = float(rng.uniform(2.6, 4.5))
    wall = shapes.panel(
        np.array([0.0, -_HALF_M, height]),
        np.array([0.0, 2 * _HALF_M, 0.0]),
        np.array([0.0, 0.0, -height]),
        tile_m=1.5,
        cells=12,
    )
    parts.add("wall", wall)
    parts.block("steel", (0.0, 0.0, height), (0.12, 2 * _HALF_M, 0.1), 1.0)
    parts.solid_box("wall", (-0.2, 0.0, height / 2), (0.4, 2 * _HALF_M, height))


def _add_tank_wall(parts: Parts, rng: np.random.Generator, radius_m: float) -> None:
    """The skin of an upright tank, which falls back to the sides, with a ring or two."""
    height = float(rng.uniform(3.0, 6.0))
    turn = np.linspace(-1.0, 1.0, 33)
    z = np.linspace(height, 0.0, 14)
    skin = np.empty((14, 33, 3))
    skin[..., 0] = radius_m * (np.cos(turn) - 1)
    skin[..., 1] = radius_m * np.sin(turn)
    skin[..., 2] = z[:, None]
    texture = np.stack(np.broadcast_arrays(radius_m * turn[None, :], -z[:, None]), -1) / 1.5
    front = np.array([3.0, 0.0, 1.0])
    parts.add("wall", seen_from(front, shapes.grid(skin, texture)))
    for at in (height - 0.1, 0.45):
        ring = np.stack([skin[[0, 1]][..., i] for i in range(3)], -1)
        ring[..., 0] += 0.05 * np.cos(turn)
        ring[..., 1] += 0.05 * np.sin(turn)
        ring[..., 2] = np.array([at + 0.06, at - 0.06])[:, None]
        parts.add("steel", seen_from(front, shapes.grid(ring, texture[:2])))
        low, high = (-radius_m, 0.0, at - 0.06), (-radius_m, 0.0, at + 0.06)
        parts.solid_rod("steel", low, high, radius_m + 0.05)
    parts.solid_rod("wall", (-radius_m, 0.0, 0.0), (-radius_m, 0.0, height), radius_m)


def _pipe(
    parts: Parts,
    rng: np.random.Generator,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    radius_m: float,
    look: str,
) -> None:
    """A pipe with flanges where its lengths are bolted together, at times with a valve on it."""
    a, b = np.array(start), np.array(end)
    parts.rod(look, a, b, radius_m, 0.9)
    length = float(np.linalg.norm(b - a))
    axis = (b - a) / length
    for at in np.arange(rng.uniform(0.5, 1.5), length, rng.uniform(1.8, 3.2)):
        middle = a + at * axis
        for off in (-0.035, 0.035):
            rim = middle + off * axis
            parts.rod("steel", rim - 0.014 * axis, rim + 0.014 * axis, 1.6 * radius_m, 0.9)
        if rng.random() < 0.35:
            stem = middle + np.array([1.9 * radius_m + 0.14, 0.0, 0.0])
            parts.rod("steel", middle, stem, 0.02, 0.9, sides=8)
            wheel = np.array([0.012, 0.0, 0.0])
            parts.rod("handle", stem - wheel, stem + wheel, 0.11, 0.9)


def _add_pipes(parts: Parts, rng: np.random.Generator, site: Site) -> None:
    """Racks of pipes above and below the board, and risers to its sides."""
    board_z = float(site.site_from_target.translation[2])
    above = board_z + CLEAR_M + 0.15
    for _ in range(int(rng.integers(1, 5))):
        radius = float(rng.uniform(0.05, 0.16))
        above += radius
        x = radius + float(rng.uniform(0.1, 0.35))
        look = "cladded" if rng.random() < 0.4 else "pipe"
        _pipe(parts, rng, (x, -6.0, above), (x, 6.0, above), radius, look)
        above += radius + float(rng.uniform(0.06, 0.25))
    below = float(rng.uniform(0.15, 0.3))
    for _ in range(int(rng.integers(0, 3))):
        radius = float(rng.uniform(0.04, 0.1))
        x = radius + float(rng.uniform(0.1, 0.3))
        if below + radius > board_z - CLEAR_M:
            break
        _pipe(parts, rng, (x, -6.0, below), (x, 6.0, below), radius, "pipe")
        below += 2 * radius + 0.12
    for side in (-1.0, 1.0):
        y = _SIDE_CLEAR_M + float(rng.uniform(0.1, 0.5))
        for _ in range(int(rng.integers(1, 4))):
            radius = float(rng.uniform(0.04, 0.14))
            y += radius
            x = radius + float(rng.uniform(0.08, 0.3))
            look = "cladded" if rng.random() < 0.4 else "pipe"
            _pipe(parts, rng, (x, side * y, 0.0), (x, side * y, 3.5), radius, look)
            y += radius + float(rng.uniform(0.1, 0.6))


def _add_columns(parts: Parts, rng: np.random.Generator) -> None:
    """Steel columns of I section, and a beam on brackets between them."""
    for side in (-1.0, 1.0):
        y = side * float(rng.uniform(2.4, 4.0))
        for x, size in ((0.5, (0.02, 0.2, 4.0)), (0.7, (0.02, 0.2, 4.0)), (0.6, (0.2, 0.02, 4.0))):
            parts.block("steel", (x, y, 2.0), size, 1.0)


def _add_instruments(parts: Parts, rng: np.random.Generator, radius_m: float) -> None:
    """Gauges, round and black on white, which are no targets; and warning signs."""

    def skin_m(y: float) -> float:
        """Where the wall is, which falls back if it is a tank's."""
        return 0.0 if math.isinf(radius_m) else math.sqrt(radius_m**2 - y**2) - radius_m

    for _ in range(int(rng.integers(1, 4))):
        y = float(rng.choice((-1, 1)) * rng.uniform(_SIDE_CLEAR_M, 2.4))
        z, size = float(rng.uniform(1.0, 2.0)), float(rng.uniform(0.12, 0.22))
        x = float(rng.uniform(0.25, 0.4))
        parts.add("dial", _plaque(x, y, z, size))
        parts.solid_box("dial", (x - 0.005, y, z), (0.01, size, size))
        parts.rod("steel", (skin_m(y), y, z), (x - 0.01, y, z), 0.03, 1.0, sides=8)
    for _ in range(int(rng.integers(1, 3))):
        y = float(rng.choice((-1, 1)) * rng.uniform(CLEAR_M + 0.2, 2.2))
        parts.add(
            "sign", _plaque(skin_m(abs(y) - 0.15) + 0.03, y, float(rng.uniform(1.0, 2.0)), 0.3)
        )


def _plaque(x: float, y: float, z: float, size_m: float) -> Shape:
    """Something flat and square before the wall that shows its texture once."""
    return shapes.panel(
        np.array([x, y - size_m / 2, z + size_m / 2]),
        np.array([0.0, size_m, 0.0]),
        np.array([0.0, 0.0, -size_m]),
        tile_m=size_m,
    )


def _add_yard(parts: Parts, rng: np.random.Generator) -> None:
    """The ground, a walkway along the wall, and tanks and a rack of pipes farther off."""
    ground = shapes.panel(
        np.array([-25.0, -25.0, 0.0]),
        np.array([0.0, 50.0, 0.0]),
        np.array([50.0, 0.0, 0.0]),
        tile_m=2.0,
        cells=30,
    )
    above = np.array([0.0, 0.0, 2.0])
    parts.add("ground", seen_from(above, ground))
    parts.solid_box("ground", (0.0, 0.0, -0.2), (50.0, 50.0, 0.4))
    walk = shapes.panel(
        np.array([0.5, -6.0, GRATING_M]),
        np.array([0.0, 12.0, 0.0]),
        np.array([1.2, 0.0, 0.0]),
        tile_m=0.6,
        cells=12,
    )
    parts.add("grating", seen_from(above, walk))
    parts.solid_box("grating", (1.1, 0.0, GRATING_M / 2), (1.2, 12.0, GRATING_M))
    for _ in range(int(rng.integers(3, 7))):
        bearing = float(rng.uniform(-math.pi, math.pi))
        away, radius = float(rng.uniform(9, 18)), float(rng.uniform(1.0, 2.8))
        x, y, height = away * math.cos(bearing), away * math.sin(bearing), rng.uniform(2.5, 8)
        look = "cladded" if rng.random() < 0.6 else "pipe"
        parts.rod(look, (x, y, 0.0), (x, y, height), radius, 1.5, sides=24)
    for z in (2.6, 3.0, 3.4):
        parts.rod("pipe", (6.5, -12.0, z), (6.5, 12.0, z), 0.12, 0.9)
    for y in np.arange(-10.0, 11.0, 4.0):
        parts.block("steel", (6.5, y, 1.7), (0.2, 0.2, 3.4), 1.0)


def _add_sky(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    zenith = np.array([0.35, 0.52, 0.80]) * rng.uniform(0.8, 1.05)
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=zenith,
        rgb2=(0.86, 0.88, 0.90),
        width=128,
        height=768,
    )
