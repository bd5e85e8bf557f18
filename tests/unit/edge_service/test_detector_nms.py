"""Suppression against a naive oracle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_service.detector.nms import pairwise_iou, suppress


def _iou(a, b):
    """The textbook formula, in plain Python."""
    w = max(0.0, min(a[2], b[2]) - max(a[0], b[0]))
    h = max(0.0, min(a[3], b[3]) - max(a[1], b[1]))
    union = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - w * h
    return w * h / union if union > 0 else 0.0


def _naive(boxes, scores, threshold, most):
    """Take the best box left, drop what overlaps it, repeat."""
    left = sorted(range(len(boxes)), key=lambda i: (-scores[i], i))
    kept = []
    while left and len(kept) < most:
        best, *left = left
        kept.append(best)
        left = [i for i in left if _iou(boxes[best], boxes[i]) <= threshold]
    return kept


def _random_boxes(seed, n):
    rng = np.random.default_rng(seed)
    corner = rng.integers(0, 40, (n, 2))
    return np.concatenate((corner, corner + rng.integers(0, 30, (n, 2))), 1).astype(np.float32), rng


@given(
    seed=st.integers(0, 10**6), n=st.integers(0, 30), threshold=st.sampled_from([0.3, 0.45, 0.6])
)
@settings(max_examples=60, deadline=None)
def test_keeps_what_the_naive_loop_keeps(seed, n, threshold):
    """Same indices in the same order, ties and empty boxes included."""
    boxes, rng = _random_boxes(seed, n)
    scores = rng.integers(0, 8, n).astype(np.float32) / 8
    got = suppress(boxes, scores, threshold, 10)
    assert got.tolist() == _naive(boxes.tolist(), scores.tolist(), threshold, 10)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_overlap_is_the_textbook_formula(seed):
    """Every pair, boxes without area included."""
    a, _ = _random_boxes(seed, 6)
    b, _ = _random_boxes(seed + 1, 5)
    want = [[_iou(x, y) for y in b.tolist()] for x in a.tolist()]
    np.testing.assert_allclose(pairwise_iou(a, b), want, atol=1e-6)


def test_nothing_in_nothing_out():
    """An empty picture is no special case."""
    kept = suppress(np.zeros((0, 4), np.float32), np.zeros(0, np.float32), 0.5, 5)
    assert kept.shape == (0,)


def test_a_row_of_touching_boxes_stays():
    """Boxes that only share an edge do not overlap."""
    boxes = np.array([[i * 10, 0, i * 10 + 10, 10] for i in range(5)], np.float32)
    kept = suppress(boxes, np.linspace(0.9, 0.5, 5, dtype=np.float32), 0.1, 10)
    assert kept.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("most", [1, 3])
def test_never_more_than_asked_for(most):
    """The bound holds, and the best ones are those that stay."""
    boxes = np.array([[i * 10, 0, i * 10 + 5, 5] for i in range(5)], np.float32)
    scores = np.array([0.1, 0.5, 0.9, 0.3, 0.7], np.float32)
    assert suppress(boxes, scores, 0.5, most).tolist() == [2, 4, 1][:most]
