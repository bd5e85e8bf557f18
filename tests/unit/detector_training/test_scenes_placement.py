"""Where the generator puts the camera and the target."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector_training.errors import SceneError
from detector_training.scenes.placement import (
    Placement,
    facing,
    random_camera,
    random_placement,
)
from detector_training.scenes.projection import (
    circle_box,
    image_from_board,
    is_in_front,
    square_box,
)


def test_an_upright_board_straight_ahead_has_the_frames_of_the_docs():
    """Target x comes towards us, y is to our right, z is up."""
    pose = facing(np.array([0.0, 0.0, 2.0]), 0.0, 0.0, 0.0)
    expected = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(pose.rotation, expected, atol=1e-12)


@given(st.floats(0, 1.2), st.floats(0, 6.28), st.floats(-3.1, 3.1))
def test_tilt_is_the_angle_between_normal_and_sight(tilt, about, roll):
    """Whatever the axis and the roll, the board's normal is tilted by what was asked."""
    centre = np.array([0.4, -0.3, 1.7])
    pose = facing(centre, tilt, about, roll)
    cosine = -(pose.rotation[:, 0] @ centre) / np.linalg.norm(centre)
    assert cosine == pytest.approx(math.cos(tilt), abs=1e-9)
    np.testing.assert_allclose(pose.translation, centre)


WHERE = Placement((14.0, 560.0), cut=0.15, any_roll=0.1)


def test_placements_cover_near_and_far_tilted_and_cut():
    """Over 400 draws: all in front, sizes span the range, some cut, some tilted over 45 degrees."""
    rng = np.random.default_rng(5)
    sizes, cut, tilted = [], 0, 0
    for _ in range(400):
        camera = random_camera(rng)
        pose = random_placement(rng, camera, 0.4, WHERE)
        assert is_in_front(pose, 0.4)
        x0, y0, x1, y1 = circle_box(image_from_board(camera, pose), 0.15)
        sizes.append(max(x1 - x0, y1 - y0))
        cut += x0 < 0 or y0 < 0 or x1 > 639 or y1 > 479
        sight = pose.translation / np.linalg.norm(pose.translation)
        tilted += -(pose.rotation[:, 0] @ sight) < math.cos(math.radians(45))
    assert min(sizes) < 14
    assert max(sizes) > 300
    assert 40 < cut < 250
    assert tilted > 30


def test_a_board_that_shall_be_whole_is_so_however_tilted():
    """A near board, tilted by up to 65 degrees: all corners in the picture; without that, not."""
    rng = np.random.default_rng(6)
    camera = random_camera(rng)

    def outside(where):
        x0, y0, x1, y1 = square_box(
            image_from_board(camera, random_placement(rng, camera, 0.4, where)), 0.4
        )
        return x0 < 0 or y0 < 0 or x1 > 639 or y1 > 479

    near = Placement((14.0, 560.0), distance_m=(0.7, 0.7), tilt_deg=(0.0, 65.0))
    assert any(outside(near) for _ in range(100))
    assert not any(outside(replace(near, whole=True)) for _ in range(100))


def test_a_board_without_a_place_is_refused():
    """A board wider than the picture cannot be whole: one line says so, and what to change."""
    rng = np.random.default_rng(6)
    where = Placement((900.0, 1000.0), tilt_deg=(0.0, 10.0), whole=True)
    with pytest.raises(SceneError, match="smaller boards"):
        random_placement(rng, random_camera(rng), 0.4, where)
