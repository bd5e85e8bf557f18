"""The localiser's bench with tiny counts: its errors, its figures, and that it measures at all."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from detector_training.scenes.placement import facing
from detector_training.scenes.printed import Paint
from detector_training.scenes.projection import image_from_board
from detector_training.scenes.warp import warp
from rgbd_wire.geometry import Pose, rotation_from_vector
from target_pose.target import load_target
from tests.perf import bench_localiser
from tests.perf.bench_detector_prints import APRILTAG, ARUCO, OURS, PRINTS
from tests.perf.bench_detector_scenes import test_backgrounds
from tests.perf.bench_localiser_errors import pose_error, squared_mahalanobis
from tests.perf.bench_localiser_goals import GOALS
from tests.perf.bench_localiser_markers import (
    ARUCO_IPPE,
    TAG_IPPE,
    TAG_OWN,
    april_tag_poses,
    aruco_poses,
    black_side_m,
)
from tests.perf.bench_localiser_poses import CAMERA, GRAVITY_SIGMA_RAD, Album, accuracy_cells
from tests.perf.bench_localiser_summary import (
    calibration,
    cell_summary,
    is_assumed_flip,
    is_covered,
    is_flip,
    paired,
    spread,
)
from tests.perf.bench_localiser_table import report_text
from tests.perf.bench_localiser_trial import Sight, Trial, with_sight

test_backgrounds.__test__ = False  # its name is what it gives
TARGET = load_target()
small = st.floats(-0.5, 0.5)
vectors = st.tuples(small, small, small).map(np.array)


@given(vectors, vectors, st.tuples(small, small), st.floats(-3.0, 3.0))
@settings(deadline=None)
def test_an_error_is_the_perturbation_that_was_made(place, turn, tilt, roll):
    """Shifted, rolled about the normal, then tilted across it: the parts come back."""
    estimate = Pose.from_rotation(rotation_from_vector(turn), place + (0.0, 0.0, 2.0))
    normal, up = estimate.rotation[:, 0], estimate.rotation[:, 2]
    across = tilt[0] * up + tilt[1] * np.cross(normal, up)
    turned = rotation_from_vector(across) @ rotation_from_vector(roll * normal)
    truth = Pose.from_rotation(turned @ estimate.rotation, estimate.translation + turn)
    error = pose_error(estimate, truth)
    np.testing.assert_allclose(error.position_m, turn, atol=1e-9)
    np.testing.assert_allclose(error.normal_rad, tilt, atol=1e-6)
    assert error.roll_rad == pytest.approx(roll, abs=1e-6)
    assert error.normal_deg == pytest.approx(math.degrees(math.hypot(*tilt)), abs=1e-4)


def test_a_normal_turned_right_over_is_180_degrees_off():
    """Opposite normals have no shortest turn; any of them is half a turn."""
    over = Pose.from_rotation(rotation_from_vector(np.array([0.0, 0.0, math.pi])), np.ones(3))
    assert pose_error(Pose(np.ones(3), np.array([1.0, 0, 0, 0])), over).normal_deg == (
        pytest.approx(180.0)
    )


def test_errors_drawn_from_a_covariance_follow_chi_square():
    """Perturbations of a pose by its own covariance: the shares inside are the levels."""
    rng = np.random.default_rng(3)
    a = rng.normal(size=(6, 6)) * np.repeat([0.02, 0.01], 3)[:, None]
    covariance = a @ a.T
    estimate = Pose.from_rotation(rotation_from_vector(rng.normal(size=3)), np.array([0.1, 0, 2]))
    trials = []
    for draw in rng.multivariate_normal(np.zeros(6), covariance, 3000):
        truth = Pose.from_rotation(
            rotation_from_vector(draw[3:]) @ estimate.rotation, estimate.translation + draw[:3]
        )
        squared = squared_mahalanobis(pose_error(estimate, truth), covariance)
        trials.append(Trial("a", "a", 1.0, 0, OURS, True, roll_source="edges", squared=squared))
    drawn = [replace(t, squared=None, squared_drawn=t.squared) for t in trials]
    assert calibration(drawn, drawn=True) == calibration(trials)
    for rows in calibration(trials).values():
        assert rows["count"] == 3000
        for level, share in rows["inside"].items():
            assert share["value"] == pytest.approx(float(level), abs=0.035)
    outside = sum(not is_covered(t) for t in trials)
    assert outside <= 12
    assert all(is_covered(t) for t in trials if t.squared["pose"] < chi2.ppf(0.99, 5))


def test_the_interval_of_a_median_holds_it():
    """In about 95 % of samples of a normal distribution; one value is its own interval."""
    rng = np.random.default_rng(4)
    inside = [s.low <= 0 <= s.high for s in (spread(rng.normal(size=25)) for _ in range(400))]
    assert 0.93 <= np.mean(inside) <= 1
    one = spread([None, 2.0])
    assert (one.count, one.low, one.median, one.high) == (1, 2.0, 2.0, 2.0)
    assert spread([None]) is None


def test_a_flip_is_far_off_and_says_nothing():
    """Over 30 degrees; declared ambiguous, refused and not found are none, nor is a bare box."""
    flip = Trial("a", "a", 1.0, 0, OURS, True, normal_deg=31.0, position_mm=1.0)
    assert is_flip(flip)
    assert not is_flip(Trial("a", "a", 1.0, 0, OURS, True, normal_deg=31.0, ambiguous=True))
    assert not is_flip(Trial("a", "a", 1.0, 0, OURS, True, normal_deg=29.0))
    assert not is_flip(Trial("a", "a", 1.0, 0, OURS, True, refusal="grazing"))
    box = replace(flip, method="box")
    assert not is_flip(box)
    assert is_assumed_flip(box)
    assert not is_assumed_flip(flip)
    assert cell_summary([flip, Trial("a", "a", 1.0, 1, OURS)])["flips"] == 1


def test_pairs_are_of_poses_that_both_have():
    """What one of the two lacks does not count for either median, but is told."""
    ours = [Trial("a", "a", 1.0, k, OURS, True, position_mm=k, normal_deg=1.0) for k in range(4)]
    theirs = [Trial("a", "a", 1.0, k, "x", True, position_mm=9.0, normal_deg=2.0) for k in (1, 3)]
    row = paired(ours[:3], [*theirs, Trial("a", "a", 1.0, 2, "x")])
    assert (row["poses"], row["both"], row["we_alone"], row["they_alone"]) == (2, 1, 1, 0)
    assert row["position_mm"]["ours"]["median"] == 1.0
    assert row["position_mm"]["theirs"]["median"] == 9.0


def picture_of_marker(printed, pose):
    """A marker on white, seen from ``pose``, sharp: each pixel is the mean over its area."""
    paint = Paint(np.full(3, 0.8, np.float32), np.full(3, 0.05, np.float32))
    texture = np.dstack([PRINTS[printed](1000, paint), np.ones((1000, 1000), np.float32)])
    seen = image_from_board(CAMERA.color, pose)
    layer = warp(texture, TARGET.board_side_m, seen, CAMERA.color.width, CAMERA.color.height)
    picture = np.full((480, 640, 3), 0.8, np.float32)
    picture[layer.window] += layer.premultiplied - 0.8 * layer.alpha[..., None]
    # grey values in proportion to light: a tone curve would shift the edges
    return np.rint(cv2.GaussianBlur(picture, (0, 0), 0.6) * 255).astype(np.uint8)


@pytest.mark.parametrize("printed", [APRILTAG, ARUCO])
def test_a_markers_corners_and_pose_are_true_to_sub_pixels(printed):
    """AprilTag's half pixel goes the right way: not a tenth of one is left on either axis."""
    side_m = black_side_m(printed, TARGET)
    if printed == APRILTAG:
        pytest.importorskip("pupil_apriltags")
        find, ways = april_tag_poses(CAMERA.color, side_m), (TAG_OWN, TAG_IPPE)
    else:
        find, ways = aruco_poses(CAMERA.color, side_m), (ARUCO_IPPE,)
    off = []
    for k in range(8):
        pose = facing(np.array([0.11 * k - 0.4, 0.05 * k - 0.2, 1.2]), 0.6, 0.8 * k, 0.1)
        ((_, poses),) = find(picture_of_marker(printed, pose))
        for way in ways:
            error = pose_error(poses[way], pose)
            assert error.position_mm < 10
            assert error.normal_deg < 1.5
            pixels = CAMERA.color.fx * error.position_m[:2] / 1.2
            off.append(pixels)
    assert (np.abs(np.mean(off, axis=0)) < 0.1).all()


def _album(tmp_path, printed=OURS, cell=1):
    backgrounds = test_backgrounds(tmp_path, ())
    return Album(accuracy_cells()[cell], printed, 5, backgrounds, tmp_path / "cache")


def test_a_pose_is_rendered_once_with_its_truth(tmp_path):
    """At its distance, whole, with depth that lies on the board; the same from the cache."""
    album = _album(tmp_path)
    view = album.view(0)
    assert view.camera_from_target.translation[2] == pytest.approx(1.2)
    x0, y0, x1, y1 = view.board_xyxy
    assert x0 >= 0
    assert y0 >= 0
    assert x1 <= 639
    assert y1 <= 479
    u, v = round((x0 + x1) / 2), round((y0 + y1) / 2)
    patch = view.depth_units[v - 4 : v + 5, u - 4 : u + 5]
    assert np.median(patch[patch > 0]) == pytest.approx(1200, abs=40)
    tip = math.acos(float(view.up_camera @ view.camera_from_target.rotation[:, 2]))
    assert 0 < tip < 6 * GRAVITY_SIGMA_RAD
    stamp = (album.folder / "images/000000.jpg").stat().st_mtime_ns
    again = album.view(0)
    assert (again.color_rgb == view.color_rgb).all()
    assert (again.up_camera == view.up_camera).all()
    assert (album.folder / "images/000000.jpg").stat().st_mtime_ns == stamp


def test_a_marker_hangs_in_the_same_pose(tmp_path):
    """Only the print differs, and depth is none of the markers' business."""
    ours, tag = (_album(tmp_path, name).view(1) for name in (OURS, APRILTAG))
    assert (ours.camera_from_target.matrix == tag.camera_from_target.matrix).all()
    assert tag.depth_units is None
    assert (ours.color_rgb != tag.color_rgb).any()


def test_a_sight_takes_away_what_it_says(tmp_path):
    """No depth, or no picture; the rest stays."""
    view = _album(tmp_path).view(0)
    assert with_sight(view, Sight.ALL, 0) is view
    assert with_sight(view, Sight.NO_DEPTH, 0).depth_units is None
    black = with_sight(view, Sight.BLACK, 0)
    assert black.color_rgb.max() < 5
    assert black.depth_units is view.depth_units


def test_all_of_it_with_one_pose_a_cell(tmp_path, capsys, monkeypatch):
    """Every part, as a user starts it: JSON, tables, trials, the plot and the worst pictures."""
    pytest.importorskip("pupil_apriltags")
    out, trials, plot = (tmp_path / name for name in ("a.md", "t.jsonl", "c.png"))
    arguments = [
        "x", "--count", "1", "--speed-poses", "2", "--jobs", "1", "--json",
        "--package-root", str(tmp_path), "--recording", str(tmp_path / "none"),
        "--cache", str(tmp_path / "cache"), "--out", str(out), "--trials", str(trials),
        "--plot", str(plot), "--worst", str(tmp_path / "worst"),
    ]  # fmt: skip
    monkeypatch.setattr(sys, "argv", arguments)
    bench_localiser.main()
    result = json.loads(capsys.readouterr().out)
    cells = {(c["condition"], c["distance_m"]) for c in result["accuracy"]["cells"]}
    assert cells == {(name, z) for name, by_m in GOALS.items() for z in by_m}
    assert len(result["side_by_side"]) == 15
    assert {c["condition"] for c in result["ladder"]["cells"]} == {"no depth", "black picture"}
    assert len(result["occlusion"]["cells"]) >= 5  # a cut target may lie outside the picture
    assert result["speed"][0]["name"] == "localise"
    assert "real" not in result
    assert out.read_text() == report_text(result)
    assert len(trials.read_text().splitlines()) > 40
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert any((tmp_path / "worst").iterdir())


def test_wrong_arguments_are_one_line(capsys, monkeypatch):
    """A count of nothing is refused before anything is loaded."""
    monkeypatch.setattr(sys, "argv", ["x", "--count", "0"])
    with pytest.raises(SystemExit) as stopped:
        bench_localiser.main()
    assert stopped.value.code == 2
    assert "give 1 or more" in capsys.readouterr().err
