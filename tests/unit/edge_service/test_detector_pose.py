"""Foreign pose models: their key points are the target's labelled points, or one clear error."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_service.detector.detector import EngineDetector
from edge_service.detector.layouts import EndToEndLayout, YoloLayout
from edge_service.detector.onnx_file import read_onnx
from edge_service.detector.onnx_model import model_of
from edge_service.errors import WeightsError
from target_pose.nesting import group
from target_pose.points import BoardPoint
from target_pose.target import Level, Shade, Target
from tests.unit.edge_service.onnx_models import constant_model

pytest.importorskip("onnxruntime")

NAMES = "{0: 'T_good'}"
POINTS = tuple(BoardPoint(f"p{k}", 0.1 * math.cos(k), 0.1 * math.sin(k)) for k in range(4))
TARGET = Target("panel", 0.3, Shade.WHITE, (), {Level.GOOD: 0.3}, points=POINTS)


def opened(answer, tmp_path, points=4, names=NAMES, kpt_shape=None, classes=None):
    """What a model that answers so is taken for."""
    model = constant_model(answer, names=names)
    if kpt_shape is not None:
        model.metadata_props.add(key="kpt_shape", value=kpt_shape)
    path = tmp_path / "pose.onnx"
    path.write_bytes(model.SerializeToString())
    return model_of(read_onnx(path), (np.asarray(answer, np.float32),), classes, points)


@pytest.mark.parametrize(
    ("shape", "kpt_shape", "kind", "numbers"),
    [
        ((1, 4 + 1 + 12, 40), None, YoloLayout, 3),
        ((1, 4 + 1 + 12, 40), "[4, 3]", YoloLayout, 3),
        ((1, 4 + 1 + 8, 40), "[4, 2]", YoloLayout, 2),
        ((1, 4 + 1 + 8, 40), None, YoloLayout, 2),
        ((1, 300, 6 + 12), "[4, 3]", EndToEndLayout, 3),
    ],
)
def test_pose_exports_are_read(shape, kpt_shape, kind, numbers, tmp_path):
    """With the metadata that exports have, and without any."""
    layout = opened(np.zeros(shape), tmp_path, kpt_shape=kpt_shape).layout
    assert isinstance(layout, kind)
    assert layout.points == 4
    assert layout.key_points.numbers == numbers


def test_boxes_alone_stay_what_they_are(tmp_path):
    """A target that has points and discs may be found by a net that knows boxes alone."""
    assert opened(np.zeros((1, 5, 40)), tmp_path).layout.points == 0
    assert opened(np.zeros((1, 300, 6)), tmp_path).layout.points == 0


@pytest.mark.parametrize(
    ("shape", "points", "kpt_shape", "says"),
    [
        ((1, 17, 40), 5, "[4, 3]", r"4 key points a box, and the target has 5 \[\[points\]\]"),
        ((1, 17, 40), 0, "[4, 3]", r"4 key points a box, and the target has no \[\[points\]\]"),
        ((1, 17, 40), 5, None, "this looks like 4 key points a box, and the target has 5"),
        ((1, 17, 40), 4, "[4, 2]", "is not known; this looks like 4 key points"),
        ((1, 16, 40), 4, None, "is not known; read are"),
        ((1, 17, 40), 4, "[0, 3]", r"kpt_shape '\[0, 3\]' is not"),
        ((1, 17, 40), 4, "[4, 7]", r"is not \[points, 2 or 3\]"),
        ((1, 17, 40), 4, "[True, 3]", "kpt_shape"),
        ((1, 17, 40), 4, "f()", "kpt_shape"),
        ((1, 17, 40), 4, "(" * 5000, "kpt_shape"),
    ],
)
def test_key_points_that_do_not_fit_the_target_say_so(shape, points, kpt_shape, says, tmp_path):
    """How many there are on either side, before any picture is looked at."""
    with pytest.raises(WeightsError, match=says):
        opened(np.zeros(shape), tmp_path, points, kpt_shape=kpt_shape)


class FixedEngine:
    """Gives one answer to every picture."""

    def __init__(self, answer):
        self.answer = answer

    def infer(self, pictures):
        return (np.repeat(self.answer, len(pictures), axis=0),)


def pose_answer(boxes, cells=40):
    """(1, 4 + 1 + 12, N) with rows of (cell, box, score, points (4, 3)) in it."""
    whole = np.zeros((1, 17, cells), np.float32)
    for cell, box, score, points in boxes:
        whole[0, :4, cell], whole[0, 4, cell] = box, score
        whole[0, 5:, cell] = np.ravel(points)
    return whole


def test_points_go_through_suppression_and_letterbox_to_the_candidate(tmp_path):
    """Of two boxes on one target the better one's points stay, in the picture's pixels, by name."""
    first = np.array([(20, 30, 0.9), (60, 28, 0.8), (62, 70, 0.7), (18, 72, 0.1)], np.float32)
    answer = pose_answer(
        [(3, (40, 50, 50, 50), 0.8, first + [1, 1, 0]), (9, (41, 50, 50, 50), 0.9, first)]
    )
    model = opened(answer, tmp_path)
    detector = EngineDetector(FixedEngine(answer), model, {"engine": "fixed"})
    assert detector.describe()["points"] == 4
    picture = np.zeros((128, 192, 3), np.uint8)  # the input is half as large
    found = detector.detect(picture)
    (box,) = found.boxes[Level.GOOD]
    want = [(2 * u - 0.5, 2 * v - 0.5, c) for u, v, c in first.tolist()]
    np.testing.assert_allclose(box.points, want, atol=1e-3)
    (candidate,) = group(found, TARGET, picture)
    assert list(candidate.points) == ["p0", "p1", "p2", "p3"]
    assert candidate.points["p2"] == box.points[2]
    assert candidate.score == pytest.approx(0.9)
