"""Lamps: a light, the glowing thing that it comes from, and what a camera sees when it looks in."""

from __future__ import annotations

import mujoco
import numpy as np

from contact_sim.scene import SEEN_GROUP, Lamp
from rgbd_wire.geometry import Array, Pose

ATTENUATION = (0.35, 0.4, 0.03)
"""Of rendered levels, which are roots of light: one over the distance is the square law."""


def add_lamp(
    spec: mujoco.MjSpec, world_from_site: Pose, place: Array, size: Array, name: str, power: float
) -> Lamp:
    """A lamp in the world.

    Args:
        spec: the world.
        world_from_site: of the frame of ``place`` and ``size``.
        place: of its middle (3,) [m].
        size: edges (3,) of what glows [m].
        name: of the light and of the geom that glows.
        power: level of white at about 1 m.
    """
    at = world_from_site @ place
    warm = power * np.array([1.0, 0.93, 0.80])
    spec.worldbody.add_light(
        name=name,
        # a spot that shines to all sides: MuJoCo's classic renderer has no points
        type=mujoco.mjtLightType.mjLIGHT_SPOT,
        cutoff=180.0,
        exponent=0.0,
        pos=at,
        diffuse=warm,
        specular=1.2 * warm,
        attenuation=ATTENUATION,
        castshadow=0,
        range=100.0,
    )
    spec.add_material(name=name, emission=1.0, rgba=(1.0, 0.98, 0.9, 1.0))
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=np.asarray(size, float) / 2,
        pos=at,
        quat=world_from_site.q_wxyz,
        material=name,
        group=SEEN_GROUP,
    )
    return Lamp(name, at, strength=0.8 * power)


def light_from_all_sides(spec: mujoco.MjSpec, level: float) -> None:
    """What is left of the light where no lamp shines; the viewer's own headlight is off."""
    head = spec.visual.headlight
    head.ambient, head.diffuse, head.specular = (level,) * 3, (0.0,) * 3, (0.0,) * 3
