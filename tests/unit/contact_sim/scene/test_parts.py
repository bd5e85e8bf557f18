"""What stands about: touched where it is seen."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from contact_sim.scene import SEEN_GROUP, TOUCHED_GROUP, WORLDS, build_scene
from contact_sim.scene.parts import Parts
from rgbd_wire.geometry import Pose, rotation_from_vector
from tests.unit.contact_sim.scene.rays import Rays

PLACE = Pose.from_rotation(rotation_from_vector(np.array([0.3, -0.2, 2.0])), np.array([1.0, 2, 3]))
ROUGH_M = 0.6
"""Rock and gravel are touched where they are on average; along a slanted ray."""


def test_a_block_and_a_rod_are_touched_where_they_are_seen():
    """From everywhere, to the chords of the rod's facets, in a place that is turned."""
    spec = mujoco.MjSpec()
    parts = Parts(spec, PLACE)
    parts.block("crate", (0.0, 0.0, 0.0), (0.4, 0.6, 0.8), 1.0)
    parts.rod("pipe", (0.5, -1.0, 0.2), (0.9, 1.0, 0.4), 0.1, 1.0, sides=40)
    parts.draw()
    rays = Rays(spec)
    rng = np.random.default_rng(1)
    met = set()
    for _ in range(400):
        start = PLACE @ (rng.uniform(-1, 1, 3) + (0.0, 0.0, 4.0))
        end = PLACE @ rng.uniform((-0.3, -1.0, -0.4), (0.9, 1.0, 0.4))
        direction = (end - start) / np.linalg.norm(end - start)
        seen, look = rays.ray(start, direction, SEEN_GROUP)
        touched, name = rays.ray(start, direction, TOUCHED_GROUP)
        if math.isinf(seen):
            continue
        # a ray that grazes the round rod may miss its facets
        if abs(touched - seen) > 0.06:
            assert "pipe" in name
            continue
        assert name.startswith(f"{look} ")
        met.add(look)
    assert met == {"crate", "pipe"}


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("seed", range(4))
def test_nothing_that_is_seen_is_air(world, seed):
    """From where the drone flies, what a ray sees it also touches; lamps and boards do both."""
    scene = build_scene(world, seed)
    rays = Rays(scene.bare)
    target, start = scene.world_from_target, scene.world_from_body.translation
    rng = np.random.default_rng(seed)
    checked = 0
    for place in np.linspace(start, target @ np.array([0.6, 0.0, 0.0]), 6):
        for _ in range(200):
            direction = rng.normal(size=3)
            direction /= np.linalg.norm(direction)
            seen, look = rays.ray(place, direction, SEEN_GROUP)
            if seen > 8.0 or look in ("board", "print", "sign") or look.startswith("lamp"):
                continue
            touched, name = rays.ray(place, direction, TOUCHED_GROUP)
            slack = ROUGH_M if look in ("rock", "ground") else 0.06
            # rays that graze something see a facet and touch what is behind it, or the reverse
            assert abs(touched - seen) < slack or _grazes(rays, place, direction, seen), (
                f"{look} is seen at {seen:.2f} m, {name} is touched at {touched:.2f} m"
            )
            checked += 1
    assert checked > 500


def _grazes(rays, place, direction, seen):
    """Whether a ray a little beside sees something else."""
    aside = np.cross(direction, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    up = np.cross(aside, direction)
    for a in np.linspace(0, 2 * math.pi, 8, endpoint=False):
        moved = place + 0.03 * (math.cos(a) * aside + math.sin(a) * up)
        if abs(rays.ray(moved, direction, SEEN_GROUP)[0] - seen) > 0.06:
            return True
        if abs(rays.ray(moved, direction, TOUCHED_GROUP)[0] - seen) < 0.06:
            return True
    return False
