"""The sheet that people look at: what is on it, where, and that nothing can break it."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import imagecodecs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_service.drawing.canvas import Canvas, text_width, wrapped
from edge_service.drawing.draw import PANEL_PX, PICTURE_PX, draw
from edge_service.drawing.files import check_drawing_path, encoded, write_drawing
from edge_service.drawing.findings import Findings, look
from edge_service.drawing.reasons import in_words
from edge_service.drawing.scene import (
    BOX_RGB,
    CIRCLE_RGB,
    OTHER_FOLD_RGB,
    circle_px,
    covariance_px,
)
from edge_service.errors import ImageError, OutputError
from edge_service.pipeline import Found, Output, Pipeline
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.clock import ManualClock
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Outcome
from target_pose.candidate import Box, Candidate, Detections
from target_pose.localisation import Localisation, Method, Refusal, RollSource
from target_pose.localise import localise
from target_pose.nesting import group
from target_pose.target import Level
from tests.unit.edge_service.edge_fakes import (
    CAMERA,
    COLOR,
    DEPTH,
    INTRINSICS,
    TARGET,
    KnownDetector,
)
from tests.unit.target_pose.render import Look, facing_pose, render_color, true_box


def findings_of(intrinsics, pose, depth=None, look_of=None):
    """A rendered picture and what the localiser finds in it with the true boxes."""
    color = render_color(TARGET, intrinsics, pose, look_of or Look(supersample=3))
    boxes = {
        level: Box(*true_box(TARGET, pose, intrinsics, side, level is Level.GOOD), 0.9)
        for level, side in TARGET.level_m.items()
    }
    camera = RgbdCamera(intrinsics, intrinsics, 0.001, Pose.identity())
    located = localise(color, depth, camera, Candidate(boxes, 0.9), TARGET)
    detections = Detections({level: (box,) for level, box in boxes.items()})
    if isinstance(located, Refusal):
        return color, Findings(detections, Output(Outcome.REFUSED, located.value))
    found = Found(Candidate(boxes, 0.9), located, None)
    return color, Findings(detections, Output(Outcome.TARGET, found=found))


def has(pixels, color):
    """How many pixels have about a colour; lines are anti-aliased."""
    return int((np.abs(pixels.astype(int) - color).max(axis=-1) < 24).sum())


TILTED = facing_pose([0.1, -0.05, 1.2], math.radians(35), 0.5)


def test_boxes_circles_and_both_folds_are_on_the_sheet():
    """Each mark in its own colour, on the picture and enlarged beside it."""
    color, findings = findings_of(INTRINSICS, TILTED)
    sheet = draw(color, INTRINSICS, TARGET, findings)
    width = sheet.shape[1] - PANEL_PX - 32
    for part in (sheet[:900, :width], sheet[:PANEL_PX, width:]):
        for mark in (*BOX_RGB.values(), CIRCLE_RGB, OTHER_FOLD_RGB):
            assert has(part, mark) > 20


def test_a_box_lies_where_it_was_found():
    """The green frame around the board, scaled with the picture, to a pixel or two."""
    color, findings = findings_of(INTRINSICS, TILTED)
    bare = Findings(findings.detections, Output(Outcome.NOT_A_TARGET, "none"))
    sheet = draw(color, INTRINSICS, TARGET, bare)
    scale = PICTURE_PX[1] / INTRINSICS.height
    box = findings.detections.boxes[Level.GOOD][0]
    green = np.abs(sheet[: PICTURE_PX[1], : 4 * 320].astype(int) - BOX_RGB[Level.GOOD]).max(-1) < 90
    column = green[:, round((box.x0 + box.x1) / 2 * scale)]
    rows = np.flatnonzero(column)
    assert rows.min() == pytest.approx((box.y0 + 0.5) * scale, abs=3)
    assert rows.max() == pytest.approx((box.y1 + 0.5) * scale, abs=3)


@pytest.mark.parametrize(
    ("size", "focal"), [((640, 480), 385.0), ((240, 320), 200.0), ((3840, 2160), 2300.0)]
)
def test_a_sheet_has_about_the_same_size_whatever_the_picture(size, focal):
    """Small pictures are enlarged, large ones reduced, upright ones fit."""
    i = CameraIntrinsics(*size, focal, focal, size[0] / 2, size[1] / 2)
    pose = facing_pose([0.05, 0.0, 1.0], 0.4)
    sheet = draw(*_split(i, findings_of(i, pose, look_of=Look(supersample=1))))
    assert 950 <= sheet.shape[0] <= 1200
    assert 1000 <= sheet.shape[1] <= 2200


def _split(intrinsics, seen):
    color, findings = seen
    return color, intrinsics, TARGET, findings


def test_the_8k_picture_is_drawn_too():
    """The drawing itself has no limit on the picture."""
    color = np.zeros((4320, 7680, 3), np.uint8)
    i = replace(INTRINSICS)
    nothing = Findings(
        Detections(dict.fromkeys(Level, ())), Output(Outcome.NOTHING_FOUND, "no box")
    )
    assert draw(color, i, TARGET, nothing).shape[0] < 1200


def test_a_target_of_40_px_is_enlarged():
    """The inset shows it across more than half of its width."""
    i = CameraIntrinsics(640, 480, 385.0, 385.0, 320.0, 240.0)
    pose = facing_pose([0.9, -0.4, 3.8], math.radians(30), 0.5)
    color, findings = findings_of(i, pose)
    box = findings.output.found.candidate.boxes[Level.GOOD]
    assert max(box.size_px) < 50
    sheet = draw(color, i, TARGET, findings)
    zoom = sheet[:PANEL_PX, -PANEL_PX - 16 : -16]
    columns = np.flatnonzero((np.abs(zoom.astype(int) - BOX_RGB[Level.GOOD]).max(-1) < 60).any(0))
    assert np.ptp(columns) > PANEL_PX / 2


@pytest.mark.parametrize("refusal", list(Refusal))
def test_every_refusal_is_said_in_words(refusal):
    """What it means and what to do, beside its name."""
    words = in_words(Output(Outcome.REFUSED, refusal.value))
    assert words.startswith(f"{refusal.value}: ")


def test_without_a_target_the_boxes_and_the_reason_are_there():
    """A refused target keeps its boxes."""
    grazing = facing_pose([0.1, 0.0, 1.2], math.radians(77), 0.2)
    color, findings = findings_of(INTRINSICS, grazing)
    assert findings.output.outcome is Outcome.REFUSED
    sheet = draw(color, INTRINSICS, TARGET, findings)
    assert has(sheet, BOX_RGB[Level.GOOD]) > 20
    assert has(sheet, CIRCLE_RGB) == 0


def test_covariance_in_the_picture_is_that_of_projected_samples():
    """95 % of the centres drawn from the covariance project into the ellipse."""
    _, findings = findings_of(INTRINSICS, TILTED)
    located = findings.output.found.localisation
    wide = replace(located, covariance=np.diag([4e-4, 1e-4, 9e-4, 1e-6, 1e-6, 1e-6]))
    outline = covariance_px(INTRINSICS, wide).astype(np.float32)
    rng = np.random.default_rng(0)
    center = wide.camera_from_target.translation
    points = rng.multivariate_normal(center, wide.covariance[:3, :3], 4000)
    uv = points[:, :2] / points[:, 2:] * 300 + (160, 120)
    inside = [cv2.pointPolygonTest(outline, (float(u), float(v)), False) >= 0 for u, v in uv]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.015)


def test_circles_are_projected_as_opencv_does():
    """The outline of a disc, point by point."""
    radius = 0.15
    uv = circle_px(INTRINSICS, TILTED, radius)
    angle = np.linspace(0, 2 * np.pi, len(uv), endpoint=False)
    rim = radius * np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1)
    rotation, _ = cv2.Rodrigues(TILTED.rotation)
    k = INTRINSICS.image_from_camera
    expected, _ = cv2.projectPoints(rim, rotation, TILTED.translation, k, None)
    np.testing.assert_allclose(uv, expected[:, 0], atol=1e-6)


coordinate = st.floats(allow_nan=True, allow_infinity=True, width=32)


@given(st.lists(st.tuples(coordinate, coordinate), min_size=0, max_size=8))
def test_no_coordinates_break_a_canvas(points):
    """NaN, infinity and what lies far outside are left out or cut off."""
    canvas = Canvas(np.zeros((40, 50, 3), np.uint8), (3.0, 4.0), 2.5)
    xy = np.array(points, dtype=np.float64).reshape(-1, 2)
    with np.errstate(all="ignore"):
        canvas.line(xy, (255, 0, 0), closed=True, halo=True)
        canvas.dashes(xy, (0, 255, 0))
        canvas.dots(xy, (0, 0, 255), 2)
        canvas.crosses(xy, (9, 9, 9), 2)
    assert canvas.pixels.shape == (40, 50, 3)


@given(st.floats(-5, 60), st.floats(-5, 60), st.floats(0.1, 20))
def test_canvas_coordinates_are_those_of_a_resize(u, v, scale):
    """A pixel's corners map to the corners of what it becomes."""
    canvas = Canvas(np.zeros((4, 4, 3), np.uint8), (0.0, 0.0), scale)
    x, y = canvas.at(np.array([u, v]))
    assert x + 0.5 == pytest.approx((u + 0.5) * scale)
    assert y + 0.5 == pytest.approx((v + 0.5) * scale)


@given(st.text(max_size=60), st.integers(40, 400))
def test_wrapped_lines_keep_every_word(words, width):
    """In order, and no line is wider unless one word alone is."""
    lines = wrapped(words, 12, width)
    assert " ".join(lines).split() == words.split()
    for line in lines:
        assert text_width(line, 12) <= width or " " not in line


def test_boxes_that_no_detector_should_give_are_survived():
    """Infinite, empty and huge boxes beside each other."""
    odd = (
        Box(-1e9, -1e9, 1e9, 1e9, 0.5),
        Box(math.nan, 0, math.inf, 5, 0.5),
        Box(7, 7, 7, 7, 0.5),
    )
    findings = Findings(Detections({Level.GOOD: odd}), Output(Outcome.NOT_A_TARGET, "x\ny é"))
    assert draw(COLOR, INTRINSICS, TARGET, findings).dtype == np.uint8


def test_a_target_that_reaches_behind_the_camera_is_survived():
    """A pose of which half the board has no pixels."""
    pose = facing_pose([0.0, 0.0, 0.12], math.radians(70))
    located = Localisation(pose, np.eye(6) * 1e-4, Method.BOX, RollSource.ASSUMED, alternative=pose)
    boxes = {Level.BETTER: Box(0, 0, 300, 200, 0.5)}
    found = Found(Candidate(boxes, 0.5), located, None)
    findings = Findings(Detections({}), Output(Outcome.TARGET, found=found))
    assert draw(COLOR, INTRINSICS, TARGET, findings).dtype == np.uint8


def pipeline(detector):
    return Pipeline(detector, TARGET, group, localise, ManualClock(0))


def test_look_keeps_the_boxes():
    """The same output as the pipeline's own, and all boxes beside it."""
    frame = RgbdFrame(COLOR, DEPTH, CAMERA, 0, None)
    findings = look(pipeline(KnownDetector()), frame)
    assert findings.output.outcome is Outcome.TARGET
    assert set(findings.detections.boxes) == set(Level)
    refused = look(pipeline(KnownDetector(error=ImageError("too small"))), frame)
    assert refused.output.outcome is Outcome.BAD_FRAME
    assert not any(refused.detections.boxes.values())


@pytest.mark.parametrize("name", ["a.png", "a.JPG", "a.jpeg"])
def test_a_drawing_is_written_whole(tmp_path, name):
    """As what its name says; nothing else stays in the folder."""
    check_drawing_path(tmp_path / name)
    write_drawing(tmp_path / name, COLOR)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    again = cv2.imread(str(tmp_path / name), cv2.IMREAD_COLOR_RGB)
    assert np.abs(again.astype(int) - COLOR).mean() < 3


def test_png_is_exact():
    """What people compare pixel by pixel."""
    np.testing.assert_array_equal(imagecodecs.png_decode(encoded(COLOR)), COLOR)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.gif", "must end in .png, .jpg, .jpeg"),
        ("a", "must end in .png"),
        ("none/a.png", "there is no folder"),
        ("folder.png", "is a folder"),
    ],
)
def test_a_path_that_cannot_be_written_is_told_first(tmp_path, name, words):
    """One line, before any work is done."""
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(OutputError, match=words):
        check_drawing_path(tmp_path / name)


def test_a_full_or_vanished_disk_is_one_line(tmp_path):
    """What shows only at the end is told the same way."""
    with pytest.raises(OutputError, match="No such file"):
        write_drawing(tmp_path / "gone" / "a.png", COLOR)
