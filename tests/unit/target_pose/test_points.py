"""Targets with labelled points: what their files say, and what is refused in one sentence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from target_pose.errors import TargetFileError
from target_pose.points import MAX_POINTS, MIN_BREADTH, breadth
from target_pose.target import Level, load_round_target, load_target, parse_target, target_file

BOARD = '[board]\nside_m = 0.3\nshade = "white"\n'
CORNERS = (("a", -0.1, 0.1), ("b", 0.1, 0.1), ("c", 0.1, -0.1), ("d", -0.1, -0.12))


def table(points, head=f'name = "panel"\n{BOARD}'):
    """A target file with these points (name, y, z), each as TOML text or as a value."""
    rows = [f'[[points]]\nname = "{n}"\ny_m = {y}\nz_m = {z}\n' for n, y, z in points]
    return head + "".join(rows)


def test_points_alone_make_a_target():
    """No discs, no levels: the one level's box is the board's."""
    target = parse_target(table(CORNERS))
    assert target.discs == ()
    assert target.level_m == {Level.GOOD: 0.3}
    assert [(p.name, p.y_m, p.z_m) for p in target.points] == list(CORNERS)


def test_the_box_of_a_target_of_points_may_have_its_own_size():
    """Where the net's box is that of something smaller than the board."""
    target = parse_target(table(CORNERS) + "[levels]\nT_good = 0.25\n")
    assert target.level_m == {Level.GOOD: 0.25}
    with pytest.raises(TargetFileError, match="a target without discs has one level, T_good, not"):
        parse_target(table(CORNERS) + "[levels]\nT_good = 0.25\nT_best = 0.1\n")


def test_discs_may_have_points_beside_them():
    """All of the bullseye stays as it is."""
    bullseye = target_file("bullseye-400").read_text()
    target = parse_target(table(CORNERS, bullseye.split("# What is printed")[0]))
    plain = load_target()
    assert (target.discs, target.level_m) == (plain.discs, plain.level_m)
    assert len(target.points) == 4
    assert plain.points == ()


@pytest.mark.parametrize(
    ("points", "told"),
    [
        (CORNERS[:3], r"4 to 64 \[\[points\]\], not 3"),
        ([(f"p{k}", 0.001 * k, 0.0002 * k * k) for k in range(MAX_POINTS + 1)], "not 65"),
        ((*CORNERS, ("a", 0.0, 0.0)), "two points are called 'a'"),
        ((*CORNERS, ("e", -0.1, 0.1)), "points a and e are less than 0.001 m apart"),
        ((*CORNERS, ("e", 0.151, 0.0)), r"point e: y_m = 0.151 m is not on the board"),
        ((*CORNERS, ("e", 0.0, "nan")), "point e: z_m = nan m is not on the board"),
        ((*CORNERS, ("e", 0.0, "true")), "point e: z_m must be in metres, not 'True'"),
        ((*CORNERS, ("e", 0.0, "1" * 5000)), "limit"),
        ((*CORNERS, ("ä", 0.0, 0.0)), "a point's name is 1 to 32 of"),
        ((*CORNERS, ("e" * 33, 0.0, 0.0)), "a point's name is 1 to 32 of"),
        ([(f"p{k}", 0.02 * k, 0.03 * k) for k in range(4)], "all points lie on one line"),
    ],
)
def test_points_that_cannot_be_are_told(points, told):
    """One sentence, with the point and the value at fault."""
    with pytest.raises(TargetFileError, match=told) as caught:
        parse_target(table(points))
    assert len(str(caught.value)) < 200
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "points = 3",
        "points = [1, 2, 3, 4]",
        'points = [{name = "a", y_m = 0.1}]',
        "points = []",
        "[[points]]\nname = 1\ny_m = 0\nz_m = 0\n" * 4,
    ],
)
def test_points_of_another_shape_are_refused(text):
    """Whatever stands there, the one error."""
    with pytest.raises(TargetFileError):
        parse_target(f'name = "panel"\n{text}\n{BOARD}' if "[[" not in text else table((), text))


def test_a_target_without_discs_and_points_lacks_discs():
    """As before there were points."""
    with pytest.raises(TargetFileError, match="lacks discs"):
        parse_target(f'name = "panel"\n{BOARD}')


def test_what_needs_discs_says_so(tmp_path):
    """Printing, training and circles cannot do without; the message says what can."""
    path = tmp_path / "panel.toml"
    path.write_text(table(CORNERS))
    assert load_target(path).points
    with pytest.raises(TargetFileError, match=r"panel has \[\[points\]\] and no \[\[discs\]\]"):
        load_round_target(path)
    assert load_round_target().discs


@given(st.integers(0, 1000), st.floats(1e-6, 1.0))
def test_breadth_is_that_of_the_spread(seed, squeeze):
    """Squeezing across the longest direction squeezes it; turning changes nothing."""
    rng = np.random.default_rng(seed)
    circle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = np.column_stack([np.cos(circle), squeeze * np.sin(circle)])
    angle = rng.uniform(0, 7)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert breadth(ring @ turn.T + 5) == pytest.approx(squeeze, rel=1e-6, abs=1e-9)
    assert breadth(np.zeros((4, 2))) == 0 < MIN_BREADTH


def test_the_localiser_of_circles_refuses_a_target_without_any():
    """It does not raise, whoever calls it."""
    from target_pose.candidate import Box, Candidate
    from target_pose.localisation import Refusal
    from target_pose.localise import localise

    intrinsics = CameraIntrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)
    camera = RgbdCamera(intrinsics, intrinsics, 0.001, Pose.identity())
    picture = np.zeros((240, 320, 3), np.uint8)
    candidate = Candidate({Level.GOOD: Box(50, 50, 200, 200, 0.9)}, 0.9)
    answer = localise(picture, None, camera, candidate, parse_target(table(CORNERS)))
    assert answer is Refusal.NO_EVIDENCE
