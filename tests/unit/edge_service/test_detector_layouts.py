"""What raw outputs mean: each layout against boxes that were put into it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_service.detector.grid import cell_centers
from edge_service.detector.layouts import (
    MAX_CELLS_PER_LEVEL,
    CellLayout,
    EndToEndLayout,
    KeyPoints,
    YoloLayout,
)
from target_pose.target import Level

SIZE = (64, 96)


def test_cells_give_the_boxes_around_their_centres():
    """One cell of the second level is sure: its box lies around its centre, and is alone."""
    n = len(cell_centers(*SIZE))
    logits, distances = np.full((2, n, 3), -9, np.float32), np.zeros((2, n, 3, 4), np.float32)
    logits[1, 7, 1], distances[1, 7, 1] = 2.0, (1, 2, 3, 4)
    found = CellLayout(tuple(Level)).read((logits, distances), 1, SIZE, 0.25)
    u, v = cell_centers(*SIZE)[7]
    assert found[Level.BETTER].boxes.tolist() == [[u - 1, v - 2, u + 3, v + 4]]
    assert found[Level.BETTER].scores == pytest.approx([1 / (1 + np.exp(-2))])
    assert len(found[Level.GOOD].scores) == len(found[Level.BEST].scores) == 0


@given(threshold=st.floats(0.01, 0.99), seed=st.integers(0, 1000))
def test_what_passes_is_what_a_whole_sigmoid_says(threshold, seed):
    """The threshold on the logits keeps the same cells, at most so many, the best of them."""
    rng = np.random.default_rng(seed)
    n = len(cell_centers(128, 160))
    logits = rng.normal(0, 3, (1, n, 3)).astype(np.float32)
    found = CellLayout(tuple(Level)).read(
        (logits, np.ones((1, n, 3, 4), np.float32)), 0, (128, 160), threshold
    )
    for c, level in enumerate(Level):
        whole = 1 / (1 + np.exp(-logits[0, :, c].astype(float)))
        want = np.sort(whole[whole > threshold])[::-1][:MAX_CELLS_PER_LEVEL]
        got = np.sort(found[level].scores)[::-1]
        assert abs(len(got) - len(want)) <= 1  # one may lie on the threshold itself
        both = min(len(got), len(want))
        np.testing.assert_allclose(got[:both], want[:both], atol=1e-6)


def test_a_yolo_column_is_a_box_by_its_middle():
    """A box from the left edge of pixel 10 to that of pixel 30 has x0 = 9.5 and x1 = 29.5 here."""
    whole = np.zeros((1, 4 + 2, 50), np.float32)
    whole[0, :, 3] = (20, 40, 20, 10, 0.1, 0.9)
    found = YoloLayout({Level.GOOD: 1, Level.BEST: 0}).read((whole,), 0, SIZE, 0.25)
    assert found[Level.GOOD].boxes.tolist() == [[9.5, 34.5, 29.5, 44.5]]
    assert found[Level.GOOD].scores == pytest.approx([0.9])
    assert len(found[Level.BEST].scores) == 0


def test_an_end_to_end_row_is_a_box_by_its_corners():
    """Rows of other classes and below the threshold are left out."""
    rows = [(10, 20, 30, 40, 0.9, 1), (0, 0, 5, 5, 0.8, 0), (0, 0, 5, 5, 0.2, 1)]
    whole = np.array([rows], np.float32)
    found = EndToEndLayout({Level.BETTER: 1}).read((whole,), 0, SIZE, 0.25)
    assert set(found) == {Level.BETTER}
    assert found[Level.BETTER].boxes.tolist() == [[9.5, 19.5, 29.5, 39.5]]


@pytest.mark.parametrize(("numbers", "confidence"), [(3, 0.75), (2, 1.0)])
def test_a_pose_column_has_its_points_behind_the_classes(numbers, confidence):
    """Point by point x, y and a confidence; without confidences all are as sure as can be."""
    whole = np.zeros((1, 4 + 2 + 4 * numbers, 50), np.float32)
    whole[0, :6, 3] = (20, 40, 20, 10, 0.1, 0.9)
    points = np.array([(10, 35), (30, 36), (29, 45), (11, 44)], np.float32)
    rows = np.column_stack([points, np.full(4, 0.75, np.float32)])[:, :numbers]
    whole[0, 6:, 3] = rows.ravel()
    layout = YoloLayout({Level.GOOD: 1}, key_points=KeyPoints(6, 4, numbers))
    found = layout.read((whole,), 0, SIZE, 0.25)[Level.GOOD]
    assert layout.points == 4
    assert found.boxes.tolist() == [[9.5, 34.5, 29.5, 44.5]]
    np.testing.assert_array_equal(found.points[0, :, :2], points - 0.5)
    np.testing.assert_array_equal(found.points[0, :, 2], confidence)


def test_an_end_to_end_pose_row_has_its_points_behind_the_class():
    """As the box is read, so are its points; other rows are left out with theirs."""
    rows = np.zeros((1, 3, 6 + 12), np.float32)
    rows[0, 0, :6] = (10, 20, 30, 40, 0.9, 1)
    rows[0, 0, 6:] = np.arange(12)
    rows[0, 1, :6] = (10, 20, 30, 40, 0.9, 0)
    layout = EndToEndLayout({Level.GOOD: 1}, key_points=KeyPoints(6, 4, 3))
    found = layout.read((rows,), 0, SIZE, 0.25)[Level.GOOD]
    np.testing.assert_array_equal(
        found.points, [[(-0.5, 0.5, 2), (2.5, 3.5, 5), (5.5, 6.5, 8), (8.5, 9.5, 11)]]
    )
