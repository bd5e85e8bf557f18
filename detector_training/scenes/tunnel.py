"""The place of the shipped recording: a service tunnel with the target on its end wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detector_training.scenes import surfaces
from detector_training.scenes.raycast import Box
from detector_training.scenes.room import Room
from rgbd_wire.geometry import Pose
from target_pose.target import Target

BOARD_THICKNESS_M = 0.012
TARGET_HEIGHT_M = 1.45


@dataclass(frozen=True, slots=True)
class Tunnel:
    """The room, and where the target hangs in it."""

    room: Room
    world_from_target: Pose


def make_tunnel(rng: np.random.Generator, target: Target) -> Tunnel:
    """A tunnel that runs east (world x), its end wall at x = 0; the target faces west."""
    half = target.board_side_m / 2
    low_z, high_z = TARGET_HEIGHT_M - half, TARGET_HEIGHT_M + half
    furniture = (
        Box((-BOARD_THICKNESS_M, -half, low_z), (0.0, half, high_z)),  # the board
        Box((-6.0, 1.75, 2.0), (0.0, 1.95, 2.2)),  # a duct along the north wall
        Box((-0.45, 0.75, 0.0), (0.0, 1.7, 1.9)),  # a cabinet beside the target
        Box((-0.25, -1.9, 0.9), (0.0, -0.75, 1.05)),  # a shelf
        Box((-0.22, -1.5, 1.05), (-0.05, -1.2, 1.35)),  # a case on it
        Box((-2.4, -2.0, 0.0), (-1.5, -1.3, 0.75)),  # a crate
        Box((-6.0, -0.12, 2.62), (0.0, 0.12, 2.8)),  # a cable tray under the ceiling
    )
    n = 512
    looks = (
        surfaces.rock(rng, n),
        surfaces.tiles(rng, n),
        surfaces.cabinets(rng, n),
        surfaces.wood(rng, n),
        surfaces.stripes(rng, n),
        surfaces.plaster(rng, n),
        surfaces.clutter(rng, n),
    )
    rock, tiles, cabinets, wood, stripes, plaster, clutter = range(len(looks))
    return Tunnel(
        Room(
            Box((-6.0, -2.0, 0.0), (0.0, 2.0, 2.8)),
            furniture,
            looks,
            (
                (rock, tiles, rock, clutter, stripes, rock),
                (plaster,) * 6,
                (stripes,) * 6,
                (cabinets,) * 6,
                (wood,) * 6,
                (plaster,) * 6,
                (wood,) * 6,
                (stripes,) * 6,
            ),
            (1.6, 1.1, 1.0, 0.8, 0.6, 1.3, 2.2),
            (-1.8, 0.9, 2.5),
            0.35,
        ),
        # x out of the wall is west, z up; so y is south, to the viewer's right
        Pose.from_rotation(
            np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]),
            np.array([-BOARD_THICKNESS_M, 0.0, TARGET_HEIGHT_M]),
        ),
    )
