"""The drone, the board and the funnel as lines, and what of them a picture shows."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.cbf import Funnel
from drone_client.viewing.moments import Settled
from drone_client.viewing.outlines import (
    board_outlines,
    circle,
    drone_outlines,
    funnel_outlines,
    funnel_radius_m,
)
from drone_client.viewing.overlay import ACCEPTED, REFUSED, caption, marks, project
from drone_client.viewing.way import Way
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import pose
from tests.unit.drone_client.view_builders import camera_from_target, facts


@given(
    a=st.floats(0.5, 9.0),
    e_m=st.floats(5e-4, 0.02),
    r_c_m=st.floats(0.005, 0.1),
    x_m=st.floats(0.0, 2.0),
    turn=st.floats(0.0, 6.3),
)
def test_the_ring_of_the_funnel_is_where_the_filter_sees_zero(
    a: float, e_m: float, r_c_m: float, x_m: float, turn: float
):
    """The barrier of the filter itself is the judge."""
    funnel = Funnel(a, e_m, r_c_m)
    radius_m = funnel_radius_m(funnel, x_m)
    y, z = radius_m * np.cos(turn), radius_m * np.sin(turn)
    assert abs(funnel.h((x_m, float(y), float(z)))) < 1e-9 * max(1.0, a)


@pytest.mark.parametrize("normal", [0, 1, 2])
def test_a_circle_lies_square_to_its_axis(normal: int):
    """All of it, at its radius, closed."""
    points = circle(0.3, normal, (1.0, 2.0, 3.0)) - (1.0, 2.0, 3.0)
    np.testing.assert_allclose(points[:, normal], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.3)
    np.testing.assert_allclose(points[0], points[-1], atol=1e-12)


def test_board_funnel_and_drone_have_their_sizes():
    """Square and discs of the printed target, the mouth, four propellers and the arm's tip."""
    known = facts()
    square, *discs = (o.points for o in board_outlines(known))
    assert np.ptp(square, axis=0) == pytest.approx([0.0, 0.4, 0.4])
    assert [np.ptp(d[:, 2]) for d in discs] == pytest.approx([0.3, 0.14, 0.06], rel=1e-3)
    mouth = funnel_outlines(known)[0].points
    np.testing.assert_allclose(np.linalg.norm(mouth, axis=1), known.funnel.r_c_m, atol=1e-9)
    drone = [o.points for o in drone_outlines(known)]
    assert any(np.allclose(line[-1], known.body_from_tip.translation) for line in drone)
    spans_m = [float(np.ptp(line[:, 0])) for line in drone[-4:]]
    assert spans_m == pytest.approx([2 * p.radius_m for p in known.propellers], rel=1e-2)


@given(
    x=st.floats(-1.0, 1.0),
    y=st.floats(-1.0, 1.0),
    z=st.floats(0.3, 5.0),
    turn=st.floats(-0.2, 0.2),
    k1=st.floats(-0.1, 0.1),
)
def test_pixels_are_opencvs(x: float, y: float, z: float, turn: float, k1: float):
    """With and without a lens, OpenCV's own projection is the judge."""
    points = np.array([(0.1, -0.2, 0.0), (-0.1, 0.1, 0.05)])
    camera_from_frame = pose((x, y, z), (turn, -turn, 0.5 * turn))
    for lens, model in ((0.0, "none"), (k1, "brown_conrady")):
        eye = CameraIntrinsics(
            640, 480, 400.0, 410.0, 321.0, 239.0, model, (lens, 0.0, 0.0, 0.0, 0.0)
        )
        rotation, _ = cv2.Rodrigues(camera_from_frame.rotation)
        expected, _ = cv2.projectPoints(
            points,
            rotation,
            camera_from_frame.translation,
            eye.image_from_camera,
            np.array(eye.coefficients),
        )
        pixels = project(points, camera_from_frame, eye)
        assert pixels is not None
        np.testing.assert_allclose(pixels, expected.reshape(-1, 2), atol=1e-6)


def test_what_is_behind_the_camera_is_not_in_its_picture():
    """Also where it is only half behind."""
    points = np.array([(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
    assert project(points, Pose.identity(), facts().camera.color) is None


def test_the_marks_lie_on_the_board_in_the_colour_of_the_verdict():
    """Green where the gate let it through, red where it did not; nothing where none was found."""
    known, found = facts(), camera_from_target(0)
    for verdict, color in (("accepted", ACCEPTED), ("too_old", REFUSED)):
        settled = Settled(1, 0, verdict, found, None, {"age_ms": 120.0})
        outline, *_ = marks(settled, known)
        assert outline.color == color
        center = project(np.zeros((1, 3)), found, known.camera.color)
        np.testing.assert_allclose(outline.points_px[:4].mean(axis=0), center[0], atol=0.5)
    assert marks(Settled(1, 0, "no_reply", None, None, {}), known) == []


def test_the_caption_says_verdict_outcome_and_age():
    """In words."""
    line = {"outcome": "nothing_found", "age_ms": 123.4}
    assert caption(Settled(1, 0, "accepted", None, None, line)) == (
        "accepted (nothing found), 123 ms old"
    )
    assert caption(Settled(1, 0, "no_reply", None, None, {})) == "no reply"


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=200))
def test_a_way_keeps_its_beginning_and_its_bound(places: list[float]):
    """However long the flight; and every point of it is a place where the drone has been."""
    way = Way(max_points=10, step_m=0.01)
    for x in places:
        way.add(np.array([x, 0.0, 0.0]))
    points = way.points()
    assert 1 <= len(points) <= 10
    assert points[0, 0] == places[0]
    assert set(points[:, 0].tolist()) <= set(places)


def test_a_way_does_not_grow_where_the_drone_hovers():
    """A minute of standing still is one point."""
    way = Way()
    for i in range(1800):
        way.add(np.array([0.001 * np.sin(i), 0.0, 1.5]))
    assert len(way.points()) == 1
