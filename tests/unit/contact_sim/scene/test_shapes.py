"""Shapes: closed ones enclose what they should, seen from outside; sheets have two sides."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.scene.shapes import block, grid, joined, moved, panel, rod, seen_from
from rgbd_wire.geometry import Pose, rotation_from_vector

lengths = st.floats(0.02, 5.0)
coordinates = st.floats(-10.0, 10.0)
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)


def volume(shape):
    """By the divergence theorem; negative where it is seen from inside."""
    a, b, c = (shape.points[shape.faces[:, i]] for i in range(3))
    return float((a * np.cross(b, c)).sum()) / 6


def faces_agree(shape):
    """Triangles' own normals point as those of their corners do."""
    a, b, c = (shape.points[shape.faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    mean = shape.normals[shape.faces].mean(axis=1)
    return bool(((across * mean).sum(axis=1) > 0).all())


@given(points, st.tuples(lengths, lengths, lengths))
def test_a_block_encloses_its_volume(center, size):
    """Length x width x height, outside out."""
    shape = block(center, size, 1.0)
    assert volume(shape) == pytest.approx(math.prod(size), rel=1e-6, abs=1e-9)
    assert faces_agree(shape)


@given(points, points, st.floats(0.01, 1.0), st.integers(6, 24))
def test_a_rod_encloses_its_volume(start, end, radius, sides):
    """Area of its polygon x length, outside out, whichever way it points."""
    length = float(np.linalg.norm(end - start))
    if length < 0.05:
        return
    polygon = 0.5 * sides * radius**2 * math.sin(2 * math.pi / sides)
    shape = rod(start, end, radius, 0.9, sides)
    assert volume(shape) == pytest.approx(polygon * length, rel=1e-4)
    assert faces_agree(shape)


@given(points)
def test_a_sheet_is_seen_from_where_it_is_asked_to(eye):
    """Seen from a point, the normals look to its side; seen twice, nothing changes."""
    if abs(eye[0]) < 0.1:
        return
    sheet = panel(np.array([0, -1.0, 1.0]), np.array([0, 2.0, 0]), np.array([0, 0, -2.0]), 1.0, 3)
    turned = seen_from(eye, sheet)
    assert faces_agree(turned)
    assert (np.sign(turned.normals[:, 0]) == np.sign(eye[0])).all()
    assert seen_from(eye, turned) is turned


def test_a_panel_shows_its_texture_upright():
    """Its first corner is the texture's, which runs right and down by so many tiles."""
    sheet = panel(np.zeros(3), np.array([0, 3.0, 0]), np.array([0, 0, -1.5]), tile_m=1.5)
    at = {tuple(p): tuple(t) for p, t in zip(sheet.points, sheet.texture, strict=True)}
    assert at[0.0, 0.0, 0.0] == (0.0, 0.0)
    assert at[0.0, 3.0, -1.5] == (2.0, 1.0)


def test_joined_shapes_keep_their_triangles():
    """The whole has the volume of its parts, wherever it is moved."""
    parts = [block((0, 0, 0), (1, 1, 1), 1.0), rod((3, 0, 0), (3, 0, 2), 0.5, 1.0)]
    whole = joined(parts)
    assert volume(whole) == pytest.approx(sum(map(volume, parts)))
    turn = rotation_from_vector(np.array([0.3, -1.0, 0.5]))
    there = moved(whole, Pose.from_rotation(turn, np.array([5.0, 1.0, -2.0])))
    assert volume(there) == pytest.approx(volume(whole))
    assert faces_agree(there)


def test_a_sphere_made_of_a_grid_has_radial_normals():
    """Normals of a curved sheet come from its neighbours."""
    a, b = np.meshgrid(np.linspace(0.5, 2.5, 40), np.linspace(-1, 1, 40), indexing="ij")
    ball = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], -1)
    shape = grid(ball, np.zeros((40, 40, 2)))
    cosine = (shape.normals * shape.points).sum(axis=1)
    assert cosine.min() > 0.998
