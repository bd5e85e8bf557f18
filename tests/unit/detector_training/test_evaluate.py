"""Scores of a detector whose every answer is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector_training.datasets.sample import Sample
from detector_training.evaluation.matching import Outcome, match
from detector_training.evaluation.precision_recall import average_precision
from detector_training.evaluation.scores import evaluate_detector
from target_pose.candidate import Box, Detections
from target_pose.target import Level, load_target


def _outcome(scores, overlaps, counts):
    return Outcome(
        np.array(scores, float),
        np.array(overlaps, np.float32).reshape(len(scores), len(counts)),
        np.array(counts, bool),
    )


def _naive_ap(outcomes, iou):
    """Precision at each recall step, made monotonic, by looping over all thresholds."""
    flat, truths = [], 0
    for o in outcomes:
        free = [bool(c) for c in o.counts]
        truths += sum(free)
        for score, row in zip(o.scores, o.overlaps, strict=True):
            best = max((x for x, f in zip(row, free, strict=True) if f), default=0.0)
            if best >= iou:
                free[[i for i, x in enumerate(row) if x == best and free[i]][0]] = False
                flat.append((score, True))
            elif not any(x >= iou and not c for x, c in zip(row, o.counts, strict=True)):
                flat.append((score, False))
    if not truths:
        return None
    flat.sort(key=lambda f: -f[0])
    points = []
    for k in range(1, len(flat) + 1):
        hits = sum(hit for _, hit in flat[:k])
        points.append((hits / truths, hits / k))
    area, recall = 0.0, 0.0
    for r in sorted({r for r, _ in points if r > 0}):
        area += (r - recall) * max(p for rr, p in points if rr >= r)
        recall = r
    return area


@st.composite
def _outcomes(draw):
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    made = []
    for _ in range(draw(st.integers(1, 5))):
        k, m = int(rng.integers(0, 5)), int(rng.integers(0, 3))
        scores = np.sort(rng.permutation(1000)[:k] + rng.random())[::-1]
        made.append(_outcome(scores, rng.random((k, m)), rng.random(m) < 0.7))
    return made


@given(outcomes=_outcomes(), iou=st.sampled_from([0.3, 0.5, 0.75]))
@settings(max_examples=80, deadline=None)
def test_average_precision_is_the_naive_one(outcomes, iou):
    """Random overlaps, ignored truths and pictures with nothing in them included."""
    want = _naive_ap(outcomes, iou)
    assert average_precision(outcomes, iou) == (None if want is None else pytest.approx(want))


@pytest.mark.parametrize(
    ("outcomes", "want"),
    [
        ([_outcome([0.9], [[0.8]], [True])], 1.0),
        ([_outcome([0.9], [[0.4]], [True])], 0.0),
        ([_outcome([], [], [True])], 0.0),
        ([_outcome([0.9, 0.8], [[0.1], [0.9]], [True])], 0.5),  # a false alarm came first
        ([_outcome([0.9, 0.8], [[0.9], [0.9]], [True])], 1.0),  # a double comes after
        ([_outcome([0.9], [[]], [])], None),
    ],
)
def test_average_precision_of_small_cases(outcomes, want):
    """Found, missed, nothing, a false alarm before and a double after, nothing to find."""
    assert average_precision(outcomes, 0.5) == want


def test_a_find_that_does_not_count_is_no_false_alarm():
    """A truth that is too small to ask for may be found at no cost."""
    hit, ignored, _ = match(_outcome([0.9, 0.5], [[0.9], [0.0]], [False]), 0.5)
    assert hit.tolist() == [False, False]
    assert ignored.tolist() == [True, False]


class _Picture(Sample):
    """A sample that needs no file."""

    def read(self):
        """A picture with a head-on target 200 px wide in its centre, if it has boxes."""
        picture = np.full((240, 320, 3), 120, np.uint8)
        if len(self.boxes):
            v, u = np.mgrid[:240, :320]
            r = np.hypot(u - 160, v - 120)
            picture[20:221, 60:261] = 220
            picture[r <= 75] = 30
            picture[r <= 35] = 220
            picture[r <= 15] = 30
        return picture


def _boxes(shift=0.0):
    return [[160 - h + shift, 120 - h, 160 + h + shift, 120 + h] for h in (100, 75, 35)]


def _sample(kind, conditions):
    boxes = np.array(_boxes() if kind == "scene" else [], np.float32).reshape(-1, 4)
    n = len(boxes)
    return _Picture(
        Path("none"), 320, 240, kind, conditions, boxes, np.arange(n), np.ones(n, np.float32)
    )


SAMPLES = (_sample("scene", ("far",)), _sample("scene", ()), _sample("negative", ("lookalike",)))


def _detector(always, shift=0.0):
    """Finds the target with these boxes, in every picture or only where it is."""

    def detect(picture):
        there = always or picture[120, 160, 0] == 30
        rows = zip(Level, _boxes(shift), strict=True)
        return Detections({k: (Box(*b, 0.9),) if there else () for k, b in rows})

    return detect


def test_a_perfect_detector_gets_full_marks():
    """Each level and the nested candidate, in every condition."""
    report = evaluate_detector(_detector(always=False), SAMPLES, load_target())
    assert report.pictures == 3
    assert set(report.rows) == {"all", "far", "lookalike", "negative"}
    for row in report.rows["all"].values():
        assert (row.truths, row.ap50.value, row.ap50_95.value, row.recall.value) == (2, 1, 1, 1)
        assert row.false_per_picture == 0.0
    assert report.rows["negative"]["T_good"].ap50 is None
    assert report.rows["far"]["candidate"].truths == 1


def test_false_alarms_are_counted_before_and_after_nesting():
    """Boxes on a blank picture are false alarms of the levels, but not of the candidate."""
    report = evaluate_detector(_detector(always=True), SAMPLES, load_target())
    assert report.rows["negative"]["T_better"].false_per_picture == 1.0
    assert report.rows["all"]["T_better"].false_per_picture == pytest.approx(1 / 3)
    assert report.rows["negative"]["candidate"].false_per_picture == 0.0


def test_boxes_beside_the_target_are_misses():
    """Shifted by 30 px: the board is still found, the small disc is not, and AP50-95 says so."""
    report = evaluate_detector(_detector(always=False, shift=30.0), SAMPLES, load_target())
    good, best = (report.rows["all"][k] for k in ("T_good", "T_best"))
    assert good.recall.value == 1.0
    assert good.ap50_95.value < 0.7
    assert best.recall.value == 0.0
    assert best.false_per_picture == pytest.approx(2 / 3)


def test_the_report_is_plain_json():
    """What ``--json`` prints."""
    plain = evaluate_detector(_detector(always=False), SAMPLES, load_target()).as_json()
    assert plain["rows"]["all"]["T_best"]["recall"]["value"] == 1.0
