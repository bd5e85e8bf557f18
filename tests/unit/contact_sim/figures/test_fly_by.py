"""Boards along a tunnel: where they hang, when they are seen, and whose answer it is."""

from __future__ import annotations

import numpy as np
import pytest

from contact_sim.figures import fly_by
from contact_sim.figures.fly_by import Sight, stays, which
from contact_sim.figures.fly_by_world import FlyBy, Seeing, build_fly_by
from contact_sim.figures.picture import camera_at, project
from contact_sim.lockstep.eyes import Look, Sizes
from contact_sim.sensing import d455
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Outcome

COLOR = d455().color


@pytest.fixture(scope="module")
def world() -> FlyBy:
    return build_fly_by(2.0)


def before(world: FlyBy, number: int, away_m: float) -> Pose:
    board = world.world_from_boards[number]
    out = board.rotation[:, 0]
    heading = float(np.arctan2(-out[1], -out[0]))
    return camera_at(board.translation + away_m * out, heading)


def test_boards_hang_upright_on_both_walls_apart_from_each_other(world):
    """Two on each side, their fronts towards the middle."""
    boards = world.world_from_boards
    assert len(boards) == 5
    fronts = [board.rotation[:, 0] for board in boards[1:]]
    np.testing.assert_allclose([front[2] for front in fronts], 0.0, atol=1e-9)
    assert fronts[0] @ fronts[1] == pytest.approx(1.0)
    assert fronts[0] @ fronts[2] == pytest.approx(-1.0)
    places = np.array([board.translation for board in boards])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    assert apart[np.triu_indices(5, 1)].min() > 2.0


def test_the_way_is_even_and_misses_the_walls(world):
    """No step is longer than the speed allows, and it stays a metre from every board."""
    places = np.array([pose.translation for pose in world.way])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps.max() <= 0.7 / world.rate_hz + 1e-9
    for board in world.world_from_boards:
        assert np.linalg.norm(places - board.translation, axis=1).min() > 1.0


@pytest.mark.parametrize("number", range(5))
def test_a_board_is_in_view_from_before_it_and_not_with_the_back_turned(world, number):
    """Whole from 1.2 m; nothing of it with the camera turned round."""
    seeing = Seeing(world, COLOR)
    pose = before(world, number, 1.2)
    assert seeing.whole(pose) == seeing.partly(pose) == number
    back = Pose.from_rotation(pose.rotation @ np.diag([-1.0, 1.0, -1.0]), pose.translation)
    assert seeing.whole(back) != number
    assert seeing.partly(back) != number


def test_a_board_that_is_cut_off_is_in_view_in_part(world):
    """Its centre in the corner of the picture; whole it is not."""
    seeing = Seeing(world, COLOR)
    pose = before(world, 1, 1.2)
    aside = camera_at(pose.translation, float(np.arctan2(*pose.rotation[[1, 0], 2])) + 0.62)
    center = project(np.zeros((1, 3)), aside.inverse() @ world.world_from_boards[1], COLOR)
    assert 0 < center[0, 0] < COLOR.width
    assert seeing.whole(aside) is None
    assert seeing.partly(aside) == 1


def test_an_answer_is_of_the_board_that_it_is_at(world):
    """Off by centimetres it is still that one's; off by half a metre it is nobody's."""
    boards = world.world_from_boards
    pose = before(world, 2, 2.0)
    truth = pose.inverse() @ boards[2]
    near = Pose(truth.translation + (0.0, 0.03, 0.04), truth.q_wxyz)
    found, off_m = which(boards, pose, near)
    assert (found, off_m) == (2, pytest.approx(0.05))
    far = Pose(truth.translation + (0.5, 0.0, 0.0), truth.q_wxyz)
    assert which(boards, pose, far) == (None, None)
    assert which(boards, pose, None) == (None, None)


def test_stays_are_the_stretches_with_a_board_in_view():
    """From the first picture of one to the picture after the last."""
    seen = (None, 1, 1, None, 2, None, None)
    in_part = (True, True, True, True, True, False, True)
    sights = [
        Sight(0.5 * i, whole, part, None, None, None)
        for i, (whole, part) in enumerate(zip(seen, in_part, strict=True))
    ]
    assert stays(sights, part=False) == [(0.5, 1.5), (2.0, 2.5)]
    assert stays(sights, part=True) == [(0.0, 2.5), (3.0, 3.5)]


class BlindEyes:
    """A service that never finds anything."""

    needs_pictures = True

    def look(self, frame, camera_from_target, chosen=None) -> Look:
        assert frame is not None
        return Look(Outcome.NOTHING_FOUND, None, Sizes(3, 1, 1))


def test_a_blind_service_counts_nothing(bench):
    """And the caption says so, without an error that nobody made."""
    bench.__dict__["service"] = BlindEyes()
    figure, caption = fly_by.draw(bench)
    assert " 0 gave the pose of one" in caption
    assert "Below, one picture of each of 5 boards, 0 of them with the pose" in caption
    assert "nan" not in caption
    assert len(figure.axes) == 1 + 5
