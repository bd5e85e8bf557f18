"""A drone that is flown from outside begins on a pad: its pilot arms it, and takes off."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import mujoco
import numpy as np

from contact_sim.errors import VehicleError
from contact_sim.scene import SEEN_GROUP, TOUCHED_GROUP, Scene
from rgbd_wire.geometry import Pose, rotation_from_vector

HULL_DOWN_M: Final = 0.035
"""From the body's origin to the underside of its hull."""
DROP_M: Final = 0.005
"""It is put down gently."""
PAD: Final = "landing pad"
PAD_M: Final = (1.0, 1.0, 0.02)
"""A plate that lies level over rails and stones: propellers that stand askew touch the ground."""
_RAYS: Final = 9
"""Along each side of the pad, for what it comes to lie on."""


def on_the_ground(scene: Scene) -> Scene:
    """The scene with a pad below where its drone would hover, and it on that, heading kept.

    Raises:
        VehicleError: there is no ground below.
    """
    ahead = scene.world_from_body.rotation[:, 0]
    turn = rotation_from_vector(np.array([0.0, 0.0, np.arctan2(ahead[1], ahead[0])]))
    start = scene.world_from_body.translation
    heading = Pose.from_rotation(turn, start)
    length_m, width_m, thick_m = PAD_M
    level_m = _highest_m(scene, heading) + thick_m
    bare = scene.bare.copy()
    bare.worldbody.add_geom(
        name=PAD,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(length_m / 2, width_m / 2, thick_m / 2),
        pos=(start[0], start[1], level_m - thick_m / 2),
        quat=heading.q_wxyz,
        rgba=(0.25, 0.26, 0.28, 1.0),
        group=SEEN_GROUP,
    )
    stands = np.array([start[0], start[1], level_m + HULL_DOWN_M + DROP_M])
    return replace(scene, bare=bare, world_from_body=Pose(stands, heading.q_wxyz))


def _highest_m(scene: Scene, heading: Pose) -> float:
    """Height of the highest thing below the pad.

    Raises:
        VehicleError: there is none.
    """
    model = scene.bare.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    groups = np.zeros(6, dtype=np.uint8)
    groups[[SEEN_GROUP, TOUCHED_GROUP]] = 1
    hit, down = np.zeros(1, dtype=np.int32), np.array([0.0, 0.0, -1.0])
    highest_m = -np.inf
    for x in np.linspace(-PAD_M[0] / 2, PAD_M[0] / 2, _RAYS):
        for y in np.linspace(-PAD_M[1] / 2, PAD_M[1] / 2, _RAYS):
            above = heading @ np.array([x, y, 0.0])
            below_m = mujoco.mj_ray(model, data, above, down, groups, 1, -1, hit)
            if below_m >= 0.0:
                highest_m = max(highest_m, above[2] - below_m)
    if not np.isfinite(highest_m):
        raise VehicleError(f"no ground below the start of world {scene.name}, {scene.seed}")
    return highest_m
