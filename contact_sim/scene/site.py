"""Where the board hangs before its wall, and where the drone starts: drawn alike in every world.

Worlds are built in the frame ``site``: origin on the floor below the board, x out of the wall, z
up, y to the left of one who looks along x. The wall near the board is the plane x = 0, or behind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from contact_sim.chance import stream
from contact_sim.scene.board import PLATE_M
from drone_client.cbf.vector import Vec3
from rgbd_wire.geometry import Array, Pose, rotation_from_vector

CLEAR_M = 0.75
"""So far to the sides of the board nothing stands out of the wall."""
SWEPT_M = 0.5
"""Half the width of the drone, propellers and all, with a little room."""
_GAP_M = 0.025


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """The places that were drawn."""

    world_from_site: Pose
    site_from_target: Pose
    site_from_body: Pose
    facts: dict[str, Any]

    @property
    def world_from_target(self) -> Pose:
        """Of the board."""
        return self.world_from_site @ self.site_from_target

    @property
    def world_from_body(self) -> Pose:
        """Of the drone at the start."""
        return self.world_from_site @ self.site_from_body


def draw_site(rng: np.random.Generator, farthest_m: float, aside_m: float) -> Site:
    """Place board and drone by chance.

    Args:
        rng: where chance comes from.
        farthest_m: room before the wall; the start is 2 m away from the board, or more.
        aside_m: room to each side of the board at the start.
    """
    heading, turn = rng.uniform(-math.pi, math.pi), math.radians(rng.uniform(-8, 8))
    lean, roll = np.radians(rng.uniform(-5, 5)), np.radians(rng.normal(0, 1.0))
    height = float(rng.uniform(1.25, 1.6))
    # turned by this much, the wall still lies behind the board's plane where the drone sweeps
    off_wall = _GAP_M + PLATE_M + SWEPT_M * abs(math.sin(turn))
    rotation = _about_z(turn) @ rotation_from_vector(np.array([roll, lean, 0.0]))
    site_from_target = Pose.from_rotation(rotation, np.array([off_wall, 0.0, height]))

    distance = float(rng.uniform(2.0, farthest_m))
    bearing = math.radians(rng.uniform(-25, 25))
    aside = float(np.clip(distance * math.sin(bearing), -aside_m, aside_m))
    away = math.sqrt(distance**2 - aside**2)
    start = site_from_target.translation + (away, aside, rng.uniform(-0.25, 0.1))
    # the nose points at the board, but for an error that may take the board out of the picture
    off_deg = float(rng.choice((-1, 1)) * rng.uniform(0, 60))
    yaw = math.atan2(-aside, -away) + math.radians(off_deg)
    facts = {
        "heading_deg": math.degrees(heading),
        "board_turn_deg": math.degrees(turn),
        "board_lean_deg": float(np.degrees(lean)),
        "board_height_m": height,
        "start_distance_m": distance,
        "start_bearing_deg": math.degrees(math.atan2(aside, away)),
        "start_off_heading_deg": off_deg,
    }
    place = np.array([rng.uniform(-20, 20), rng.uniform(-20, 20), 0.0])
    return Site(
        Pose.from_rotation(_about_z(heading), place),
        site_from_target,
        Pose.from_rotation(_about_z(yaw), start),
        facts,
    )


def draw_wind(seed: int, along_world: Array, fastest_mps: float, aside_rad: float) -> Vec3:
    """The mean wind [m/s] of a seed, which blows along walls, up or down them by chance.

    Args:
        seed: of the world; the draws are of a stream of their own.
        along_world: (3,) unit vector along the wall, level.
        fastest_mps: from calm to this, all alike.
        aside_rad: by how much it may blow towards the wall, or away from it.
    """
    rng = stream(seed, "weather")
    speed_mps = float(rng.choice((-1, 1)) * rng.uniform(0.0, fastest_mps))
    turned = _about_z(float(rng.uniform(-aside_rad, aside_rad))) @ along_world
    x, y, z = (speed_mps * turned).tolist()
    return x, y, z


def _about_z(angle_rad: float) -> Array:
    return rotation_from_vector(np.array([0.0, 0.0, angle_rad]))
