"""The outer disc's outline after the detector's boxes."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics
from target_pose.box_guess import box_guesses
from target_pose.candidate import Box, Candidate
from target_pose.target import Level, load_target

TARGET = load_target()
CAMERA = CameraIntrinsics(640, 480, 600.0, 600.0, 320.0, 240.0)


def guesses(**sides):
    boxes = {Level[name]: Box(*box, 0.9) for name, box in sides.items()}
    return box_guesses(Candidate(boxes, 0.9), TARGET, CAMERA)


@pytest.mark.parametrize(("level", "side"), [("GOOD", 80), ("BETTER", 60), ("BEST", 28)])
def test_each_level_s_box_tells_the_outer_disc(level, side):
    (guess,) = guesses(**{level: (300 - side / 2, 200 - side / 2, 300 + side / 2, 200 + side / 2)})
    assert guess.disc.center_px == pytest.approx((300, 200))
    assert guess.disc.semi_axes_px == pytest.approx((30, 30))
    assert guess.width_px == pytest.approx(60)
    assert not guess.cut


def test_whole_boxes_share_their_centre_and_the_disc_s_own_box_gives_the_size():
    first, *others = guesses(GOOD=(262, 160, 342, 240), BETTER=(268, 170, 328, 230))
    assert first.disc.center_px == pytest.approx((300, 200))
    assert first.disc.semi_axes_px == pytest.approx((30, 30))
    assert len(others) == 2


def test_a_whole_box_goes_before_one_that_the_border_cuts():
    first, *_ = guesses(BETTER=(600, 200, 640, 260), BEST=(590, 216, 618, 244))
    assert not first.cut
    assert first.disc.semi_axes_px == pytest.approx((30, 30))


def test_a_box_cut_on_one_side_is_completed_to_a_square():
    (guess,) = guesses(BETTER=(600, 200, 640, 260))
    assert guess.cut
    assert guess.sized
    assert guess.disc.center_px == pytest.approx((630, 230))


def test_a_box_cut_in_both_directions_tells_no_size():
    (guess,) = guesses(BETTER=(600, 440, 640, 480))
    assert guess.cut
    assert not guess.sized


@pytest.mark.parametrize(
    "box",
    [
        (math.nan, 0, 10, 10),
        (0, 0, math.inf, 10),
        (-1e300, -1e300, 1e300, 1e300),
        (50, 50, 40, 60),
        (50, 50, 50, 50),
        (700, 100, 760, 160),
        (100, 100, 300, 110),
    ],
)
def test_a_box_that_is_none_tells_nothing(box):
    assert guesses(BETTER=box) == []


@settings(deadline=None, max_examples=100)
@given(st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 4))
def test_any_four_numbers_give_a_finite_guess_or_none(box):
    for guess in guesses(GOOD=box, BEST=box):
        assert all(map(math.isfinite, (*guess.disc.center_px, *guess.disc.semi_axes_px)))
        assert min(guess.disc.semi_axes_px) > 0
