"""A drone that is flown from outside begins on the ground: its pilot arms it, and takes off."""

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


def on_the_ground(scene: Scene) -> Scene:
    """The scene with its drone level on the ground below where it would hover, heading kept.

    Raises:
        VehicleError: there is no ground below.
    """
    model = scene.spec.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = scene.world_from_body
    groups = np.zeros(6, dtype=np.uint8)
    groups[[SEEN_GROUP, TOUCHED_GROUP]] = 1
    hit = np.zeros(1, dtype=np.int32)
    below_m = mujoco.mj_ray(
        model, data, start.translation, np.array([0.0, 0.0, -1.0]), groups, 1, -1, hit
    )
    if below_m < 0.0:
        raise VehicleError(f"no ground below the start of world {scene.name}, {scene.seed}")
    ahead = start.rotation[:, 0]
    heading = rotation_from_vector(np.array([0.0, 0.0, np.arctan2(ahead[1], ahead[0])]))
    place = start.translation - (0.0, 0.0, below_m - HULL_DOWN_M - DROP_M)
    return replace(scene, world_from_body=Pose.from_rotation(heading, place))
