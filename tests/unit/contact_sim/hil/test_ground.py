"""The drone on the ground, where it begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contact_sim.errors import VehicleError
from contact_sim.hil.ground import PAD, on_the_ground
from contact_sim.scene import build_scene
from contact_sim.simulation import Simulation, SimulationSettings
from rgbd_wire.geometry import Pose, rotation_from_vector
from tests.unit.contact_sim.flights import AIRFRAME, RIG, plain_scene

OUTSIDE = SimulationSettings(rotors_from_outside=True)


@pytest.mark.parametrize(
    ("world", "seed"), [("tunnel", 0), ("tunnel", 4), ("tunnel", 5), ("refinery", 1)]
)
def test_it_stands_still_in_every_world(world, seed):
    """Level to a few degrees, below where it would hover, looking the same way."""
    hovering = build_scene(world, seed)
    scene = on_the_ground(hovering)
    sim = Simulation(scene, AIRFRAME, RIG, seed, OUTSIDE)
    sim.step(1000)
    at = sim.truth.world_from_body
    assert np.linalg.norm(sim.truth.velocity_world) < 1e-3
    assert at.rotation[2, 2] > np.cos(np.radians(0.5))
    assert {(t.part, t.other) for t in sim.contacts.touches} == {("drone/body", PAD)}
    assert np.abs(at.translation - hovering.world_from_body.translation)[:2].max() < 0.01
    assert at.translation[2] - hovering.floor_m == pytest.approx(0.0, abs=0.2)
    assert at.rotation[:, 0] @ hovering.world_from_body.rotation[:, 0] > 0.99


def test_it_is_put_down_level():
    """Whatever its attitude in the air; the heading is kept."""
    scene = plain_scene()
    tilted = Pose.from_rotation(
        rotation_from_vector(np.array([0.0, 0.0, 0.8]))
        @ rotation_from_vector(np.array([0.1, 0.2, 0])),
        np.array([0.3, -0.2, 1.5]),
    )
    down = on_the_ground(replace(scene, world_from_body=tilted)).world_from_body
    assert down.rotation[2, 2] == pytest.approx(1.0)
    ahead = tilted.rotation[:2, 0] / np.linalg.norm(tilted.rotation[:2, 0])
    assert down.rotation[:2, 0] == pytest.approx(ahead)
    assert down.translation == pytest.approx([0.3, -0.2, 0.06])


def test_without_ground_it_cannot_begin():
    """Somebody put it under the floor."""
    scene = replace(
        plain_scene(), world_from_body=Pose.from_rotation(np.eye(3), np.array([0.0, 0.0, -5.0]))
    )
    with pytest.raises(VehicleError, match="no ground below the start of world plain"):
        on_the_ground(scene)
