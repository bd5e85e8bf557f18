"""Nesting: targets at any pose pass, look-alikes do not."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics
from target_pose.candidate import Box, Detections
from target_pose.nesting import LOOSE_SIZE_SLACK, MAX_BOXES, SHADES_WEIGHT, group, nests
from target_pose.points import BoardPoint, PointPx
from target_pose.target import Disc, Level, Shade, Target, load_target
from tests.unit.target_pose.render import Look, facing_pose, render_color, true_box

TARGET = load_target()
CAMERA = CameraIntrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)


def _boxes(pose, score=0.8):
    return {
        level: Box(
            *(
                float(x)
                for x in true_box(TARGET, pose, CAMERA, TARGET.level_m[level], level is Level.GOOD)
            ),
            score,
        )
        for level in Level
    }


def _picture(pose, **look):
    gray_or_rgb = render_color(
        TARGET, CAMERA, pose, Look(supersample=3, **look), np.random.default_rng(0)
    )
    return np.ascontiguousarray(gray_or_rgb)


def _detections(*targets):
    return Detections({level: tuple(t[level] for t in targets if level in t) for level in Level})


def _head_on(scale=1.0, center=(160.0, 120.0)):
    """Boxes and picture of a head-on target drawn by hand, 120 px wide at scale one."""
    picture = np.full((240, 320, 3), 120, np.uint8)
    half = {Level.GOOD: 60 * scale, Level.BETTER: 45 * scale, Level.BEST: 21 * scale}
    c = np.array(center)
    corner = [tuple(np.round(c + s * half[Level.GOOD]).astype(int).tolist()) for s in (-1, 1)]
    cv2.rectangle(picture, *corner, (220,) * 3, -1)
    at = tuple(np.round(c).astype(int).tolist())
    for radius, gray in ((45 * scale, 30), (21 * scale, 220), (9 * scale, 30)):
        cv2.circle(picture, at, round(radius), (gray,) * 3, -1, cv2.LINE_AA)
    boxes = {level: Box(*(c - h).tolist(), *(c + h).tolist(), 0.95) for level, h in half.items()}
    return boxes, picture


def _smallest(boxes):
    return min(min(box.size_px) for box in boxes.values())


@given(
    tilt_deg=st.floats(0, 70),
    azimuth=st.floats(0, 6.28),
    roll=st.floats(0, 6.28),
    distance=st.floats(0.6, 5.0),
    u=st.floats(20, 300),
    v=st.floats(20, 220),
    dim=st.floats(0.25, 1.0),
)
@example(0.0, 0.0, 0.785, 0.8, 160.0, 120.0, 1.0)
@example(70.0, 0.0, 0.785, 0.7, 160.0, 120.0, 1.0)
@settings(max_examples=30, deadline=None)
def test_a_projected_target_is_accepted(tilt_deg, azimuth, roll, distance, u, v, dim):
    """Boxes of the true shapes, tilted to 70 degrees, near and far, whole or cut, in any light."""
    ray = np.array([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1.0])
    pose = facing_pose(ray * distance, np.deg2rad(tilt_deg), azimuth, roll)
    boxes = _boxes(pose)
    assume(_smallest(boxes) >= 6)
    disc = boxes[Level.BETTER]
    assume(disc.x0 > -20 and disc.y0 > -20 and disc.x1 < 340 and disc.y1 < 260)
    found = group(_detections(boxes), TARGET, _picture(pose, dim=dim))
    assert len(found) == 1
    whole = min(disc.x0, disc.y0) > 0 and disc.x1 < 319 and disc.y1 < 239
    if whole and distance > 1.2:
        assert found[0].boxes == boxes


@given(
    tilt_deg=st.floats(0, 70),
    azimuth=st.floats(0, 6.28),
    roll=st.floats(0, 6.28),
    distance=st.floats(1.0, 6.0),
)
@settings(max_examples=100, deadline=None)
def test_true_boxes_nest_by_geometry_alone(tilt_deg, azimuth, roll, distance):
    """Every pair of levels of a projected target passes the check of centres and sizes."""
    pose = facing_pose([0.1, -0.1, distance], np.deg2rad(tilt_deg), azimuth, roll)
    boxes, m = _boxes(pose), TARGET.level_m
    for outer, inner in ((Level.GOOD, Level.BETTER), (Level.BETTER, Level.BEST)):
        least = m[outer] / m[inner]
        most = least * (2**0.5 if outer is Level.GOOD else 1)
        assert nests(boxes[outer], boxes[inner], (least, most), (320, 240))


@pytest.mark.parametrize(
    ("side", "shift", "fits"),
    [(200, 0, True), (130, 0, False), (300, 0, False), (200, 50, False), (170, 0, False)],
)
def test_size_and_place_are_bounded_on_both_sides(side, shift, fits):
    """A box twice as large must be neither 1.3 nor 3 times as large, nor beside."""
    inner = Box(450, 450, 550, 550, 0.9)
    u = 500 + shift
    outer = Box(u - side / 2, 500 - side / 2, u + side / 2, 500 + side / 2, 0.9)
    assert nests(outer, inner, (2.0, 2.0), (1000, 1000)) == fits


@pytest.mark.parametrize(("side", "fits"), [(160, False), (170, True), (300, False)])
def test_a_loose_box_may_be_too_small_alone(side, fits):
    """Not too large: what hides a part of a shape does not make it larger."""
    inner, half = Box(450, 450, 550, 550, 0.9), side / 2
    outer = Box(500 - half, 500 - half, 500 + half, 500 + half, 0.9)
    assert nests(outer, inner, (2.0, 2.0), (1000, 1000), LOOSE_SIZE_SLACK) == fits


@pytest.mark.parametrize("missing", list(Level))
def test_a_level_may_be_missing(missing):
    """Two levels of three make a target."""
    boxes, picture = _head_on()
    del boxes[missing]
    (found,) = group(_detections(boxes), TARGET, picture)
    assert found.boxes == boxes


@pytest.mark.parametrize("level", list(Level))
def test_a_lone_box_is_no_target(level):
    """However sure the net is, and even on a true target."""
    boxes, picture = _head_on()
    alone = {level: dataclasses.replace(boxes[level], score=0.99)}
    assert group(_detections(alone), TARGET, picture) == ()


@pytest.mark.parametrize(("score", "accepted"), [(0.5, 0), (0.7, 1)])
def test_three_doubtful_boxes_are_no_target(score, accepted):
    """Below the least score nothing is a candidate."""
    boxes, picture = _head_on()
    doubtful = {level: dataclasses.replace(box, score=score) for level, box in boxes.items()}
    assert len(group(_detections(doubtful), TARGET, picture)) == accepted


@pytest.mark.parametrize(("scale", "counted"), [(0.15, 2), (0.25, 3)])
def test_a_disc_too_small_to_be_seen_is_not_missed(scale, counted):
    """Without the inner disc the net's share is the mean of two where that disc is under 8 px."""
    boxes, picture = _head_on(scale)
    del boxes[Level.BEST]
    (found,) = group(_detections(boxes), TARGET, picture)
    net = 1.9 / counted
    assert net / (1 + SHADES_WEIGHT) <= found.score <= (net + SHADES_WEIGHT) / (1 + SHADES_WEIGHT)


@pytest.mark.parametrize("scale", [1.0, 0.3, 0.15])
def test_an_inverted_target_is_rejected(scale):
    """White where it should be black, at any size: no target."""
    boxes, picture = _head_on(scale)
    assert len(group(_detections(boxes), TARGET, picture)) == 1
    assert group(_detections(boxes), TARGET, 255 - picture) == ()


def _disc(picture, radius, gray):
    cv2.circle(picture, (160, 120), radius, (gray,) * 3, -1, cv2.LINE_AA)


@pytest.mark.parametrize(
    "rings",
    [
        [(45, 30)],  # a black disc
        [(45, 30), (21, 220)],  # a thick ring without the dot
        [(45, 220), (21, 30)],  # a small black disc
        [(45, 30), (38, 220), (21, 30), (14, 220)],  # two thin rings
        [(45, 120), (21, 120), (9, 120)],  # nothing at all
    ],
)
def test_other_rings_on_a_white_board_are_rejected(rings):
    """Even when the net has put perfect boxes on them."""
    boxes, picture = _head_on()
    cv2.circle(picture, (160, 120), 46, (220,) * 3, -1)
    for radius, gray in rings:
        _disc(picture, radius, gray)
    assert group(_detections(boxes), TARGET, picture) == ()


@pytest.mark.parametrize("radius", [13, 30, 36])
def test_a_ring_of_another_width_is_rejected(radius):
    """The net boxes the inner disc where it is: the ratio is wrong, and without it the picture."""
    boxes, picture = _head_on()
    for r, gray in ((45, 30), (radius, 220), (round(radius * 0.43), 30)):
        _disc(picture, r, gray)
    u, v = 160, 120
    other = {**boxes, Level.BEST: Box(u - radius, v - radius, u + radius, v + radius, 0.9)}
    assert group(_detections(other), TARGET, picture) == ()


@pytest.mark.parametrize(
    ("level", "factor", "shift"),
    [(Level.BEST, 1.6, 0), (Level.BEST, 0.6, 0), (Level.BETTER, 0.7, 0), (Level.BEST, 1.0, 18)],
)
def test_a_box_of_the_wrong_size_or_place_is_left_out(level, factor, shift):
    """The other two levels make the target without it."""
    boxes, picture = _head_on()
    (u, v), (w, h) = boxes[level].center_px, boxes[level].size_px
    w, h, u = w * factor, h * factor, u + shift
    wrong = {**boxes, level: Box(u - w / 2, v - h / 2, u + w / 2, v + h / 2, 0.9)}
    (found,) = group(_detections(wrong), TARGET, picture)
    assert found.boxes == {k: b for k, b in boxes.items() if k is not level}


def _touched(disc=0.86, arm_px=6):
    """Boxes and picture of a board whose middle an arm is about to touch, as the net draws them.

    The disc's box is too small to fit the inner disc's; the scores are those of a flight.
    """
    boxes, picture = _head_on()
    half = 45 * disc
    boxes[Level.BETTER] = Box(160 - half, 120 - half, 160 + half, 120 + half, 0.82)
    boxes[Level.GOOD] = dataclasses.replace(boxes[Level.GOOD], score=0.74)
    boxes[Level.BEST] = dataclasses.replace(boxes[Level.BEST], score=0.78)
    foot = [(160 + arm_px, 239), (160 - arm_px, 239)]
    cv2.fillPoly(picture, [np.array([(158, 120), (162, 120), *foot])], (15, 15, 15))
    cv2.circle(picture, (160, 120), 4, (8, 8, 8), -1)
    return boxes, picture


def test_a_board_is_found_while_an_arm_touches_its_middle():
    """The box that the arm has spoilt counts in the score, and is left out of the candidate."""
    boxes, picture = _touched()
    (found,) = group(_detections(boxes), TARGET, picture)
    assert found.boxes == {k: b for k, b in boxes.items() if k is not Level.BETTER}
    net = (0.74 + 0.82 + 0.78) / 3
    assert found.score == pytest.approx((net + SHADES_WEIGHT) / (1 + SHADES_WEIGHT), abs=0.03)


def test_a_spoilt_box_needs_rings_of_the_right_shades():
    """On four rays of five, where three boxes that fit need every other one."""
    boxes, picture = _touched()
    assert group(_detections(boxes), TARGET, 255 - picture) == ()
    assert group(_detections(boxes), TARGET, np.full_like(picture, 128)) == ()
    boxes, half_hidden = _touched(arm_px=110)
    fitting = {**boxes, Level.BETTER: dataclasses.replace(_head_on()[0][Level.BETTER], score=0.82)}
    assert len(group(_detections(fitting), TARGET, half_hidden)) == 1
    assert group(_detections(boxes), TARGET, half_hidden) == ()


def test_a_box_that_is_much_too_small_speaks_for_nothing():
    """Nor does one that is not there: the two others are too doubtful alone."""
    boxes, picture = _touched(disc=0.7)
    assert group(_detections(boxes), TARGET, picture) == ()
    del boxes[Level.BETTER]
    assert group(_detections(boxes), TARGET, picture) == ()


def test_a_flat_gray_picture_holds_no_target():
    """Boxes alone convince nobody."""
    boxes, picture = _head_on()
    assert group(_detections(boxes), TARGET, np.full_like(picture, 128)) == ()


def test_low_contrast_in_the_dark_is_enough():
    """Eight gray levels between black and white still tell the rings apart."""
    boxes, picture = _head_on()
    dark = (picture.astype(float) * 0.05 + 2).astype(np.uint8)
    assert int(dark.max()) <= 13
    assert len(group(_detections(boxes), TARGET, dark)) == 1


def test_a_shadow_across_the_target_is_no_edge_of_it():
    """Light that falls to a quarter from left to right does not hide the rings."""
    boxes, picture = _head_on()
    shade = np.linspace(1.0, 0.25, 320)[None, :, None]
    assert len(group(_detections(boxes), TARGET, (picture * shade).astype(np.uint8))) == 1


def test_two_targets_come_best_first():
    """Both are found, the surer one leads."""
    left, right = _head_on(0.5, (80, 120)), _head_on(0.5, (240, 120))
    picture = np.where(np.arange(320)[None, :, None] < 160, left[1], right[1])
    sure = {k: Box(b.x0, b.y0, b.x1, b.y1, 0.99) for k, b in right[0].items()}
    found = group(_detections(left[0], sure), TARGET, picture)
    assert [c.boxes for c in found] == [sure, left[0]]
    assert found[0].score > found[1].score


def test_a_second_box_on_the_same_target_is_no_second_target():
    """A lone sure box that suppression left beside the right one adds nothing."""
    boxes, picture = _head_on()
    double = Box(*(x + 12 for x in (114.0, 74.0, 204.0, 164.0)), 0.9)
    made = _detections(boxes).boxes
    crowd = Detections({**made, Level.BETTER: (double, *made[Level.BETTER])})
    (found,) = group(crowd, TARGET, picture)
    assert found.boxes == boxes


def test_a_whole_target_outranks_its_parts():
    """The score counts every level, so that one lacking a level is worth less."""
    boxes, picture = _head_on()
    (whole,) = group(_detections(boxes), TARGET, picture)
    del boxes[Level.BEST]
    (part,) = group(_detections(boxes), TARGET, picture)
    assert part.score < whole.score == pytest.approx((0.95 + SHADES_WEIGHT) / (1 + SHADES_WEIGHT))


def test_a_crowd_of_boxes_is_bounded():
    """Hundreds of boxes are cut to the best ones, the target among them is found."""
    boxes, picture = _head_on()
    rng = np.random.default_rng(0)
    corner = rng.uniform(0, 200, (300, 2))
    noise = tuple(Box(x, y, x + 40, y + 30, 0.3) for x, y in corner.tolist())
    crowd = Detections({level: (boxes[level], *noise) for level in Level})
    assert len(crowd.boxes[Level.GOOD]) > MAX_BOXES
    (found,) = group(crowd, TARGET, picture)
    assert found.boxes == boxes


def test_nothing_detected_is_no_target():
    """Neither an empty answer nor one without levels is an error."""
    _, picture = _head_on()
    assert group(Detections({}), TARGET, picture) == ()
    assert group(Detections(dict.fromkeys(Level, ())), TARGET, picture) == ()


def test_another_target_is_judged_by_its_own_file():
    """A black board with a white disc and a black dot: what is wrong here is right there."""
    mine = Target(
        "mine",
        0.4,
        Shade.BLACK,
        (Disc(0.3, Shade.WHITE), Disc(0.14, Shade.BLACK), Disc(0.06, Shade.WHITE)),
        TARGET.level_m,
    )
    boxes, picture = _head_on()
    assert group(_detections(boxes), mine, picture) == ()
    assert len(group(_detections(boxes), mine, 255 - picture)) == 1


def test_a_box_with_the_points_of_a_target_without_discs_is_a_candidate():
    """One class has nothing to nest: each box that has all points is one, the best in its place."""
    points = tuple(BoardPoint(f"p{k}", 0.1 * k - 0.15, 0.1 * (k % 2)) for k in range(4))
    panel = Target("panel", 0.4, Shade.WHITE, (), {Level.GOOD: 0.4}, points=points)
    seen = tuple(PointPx(50.0 + 10 * k, 60.0, 0.9) for k in range(4))
    best = Box(40, 40, 100, 100, 0.9, seen)
    worse = dataclasses.replace(best, x1=104, score=0.6)
    elsewhere = dataclasses.replace(best, x0=200, x1=260, score=0.5)
    pointless = Box(10, 200, 30, 220, 0.95)
    short = dataclasses.replace(elsewhere, y0=150, y1=200, points=seen[:3])
    boxes = {Level.GOOD: (pointless, best, worse, elsewhere, short), Level.BEST: (best,)}
    found = group(Detections(boxes), panel, np.zeros((240, 320, 3), np.uint8))
    assert [(c.boxes, c.score) for c in found] == [
        ({Level.GOOD: best}, 0.9),
        ({Level.GOOD: elsewhere}, 0.5),
    ]
    assert found[0].points == {f"p{k}": seen[k] for k in range(4)}


def test_a_bullseyes_candidate_has_the_points_of_its_surest_box():
    """And none where the net gave none."""
    boxes, picture = _head_on()
    points = tuple(BoardPoint(f"p{k}", 0.1 * k - 0.15, 0.1 * (k % 2)) for k in range(4))
    target = dataclasses.replace(TARGET, points=points)
    seen = tuple(PointPx(150.0 + k, 110.0, 0.9) for k in range(4))
    other = tuple(PointPx(10.0, 10.0, 0.9) for _ in range(4))
    boxes[Level.BEST] = dataclasses.replace(boxes[Level.BEST], score=0.99, points=seen)
    boxes[Level.GOOD] = dataclasses.replace(boxes[Level.GOOD], points=other)
    (found,) = group(_detections(boxes), target, picture)
    assert found.points == {f"p{k}": seen[k] for k in range(4)}
    (found,) = group(_detections(boxes), TARGET, picture)
    assert found.points == {}
