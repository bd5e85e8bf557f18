"""Assignment: who learns what, per class."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from detector_training.training.assign import TOP_K, Truth, assign, box_iou, candidates
from edge_service.detector.boxes import cell_centers

CENTERS, STRIDES = cell_centers(128, 160)
N = len(CENTERS)


def _truth(*rows, ignore=()):
    """Rows of (class, x0, y0, x1, y1)."""
    table = torch.tensor(rows, dtype=torch.float32).reshape(-1, 5)
    ignored = torch.tensor([k in ignore for k in range(len(table))], dtype=torch.bool)
    return Truth(table[:, 1:], table[:, 0].long(), ignored)


def _guess(seed=0):
    """Scores (N, 3) and boxes (N, 3, 4) of a net that knows a little."""
    g = torch.Generator().manual_seed(seed)
    reach = torch.rand(N, 3, 4, generator=g) * 40 + 5
    boxes = torch.cat((CENTERS[:, None] - reach[..., :2], CENTERS[:, None] + reach[..., 2:]), -1)
    return torch.rand(N, 3, generator=g), boxes


@st.composite
def _truths(draw):
    rows = []
    for k in range(draw(st.integers(0, 4))):
        x, y = draw(st.floats(-10, 150)), draw(st.floats(-10, 120))
        w, h = draw(st.floats(5, 120)), draw(st.floats(5, 120))
        rows.append((k % 3, x, y, x + w, y + h))
    return _truth(*rows)


@given(truth=_truths(), seed=st.integers(0, 50))
@settings(max_examples=60, deadline=None)
def test_positives_lie_where_they_may_and_aim_at_a_true_box(truth, seed):
    """Every positive is a candidate of a true box of its class, and that box is its target."""
    scores, boxes = _guess(seed)
    target = assign(scores, boxes, truth, CENTERS, STRIDES)
    allowed = candidates(truth.boxes, CENTERS, STRIDES)
    for cell, c in torch.nonzero(target.scores > 0).tolist():
        mine = [
            k
            for k in range(len(truth.boxes))
            if truth.classes[k] == c and torch.equal(truth.boxes[k], target.boxes[cell, c])
        ]
        assert mine
        assert any(allowed[k, cell] for k in mine)
    assert bool((target.scores >= 0).all())
    assert bool((target.scores <= 1).all())


@given(truth=_truths(), seed=st.integers(0, 50))
@settings(max_examples=60, deadline=None)
def test_every_box_with_a_cell_inside_gets_a_teacher_but_few(truth, seed):
    """No box is left out (unless a rival of its class took all), none takes over ``TOP_K``."""
    scores, boxes = _guess(seed)
    target = assign(scores, boxes, truth, CENTERS, STRIDES)
    allowed = candidates(truth.boxes, CENTERS, STRIDES)
    for k in range(len(truth.boxes)):
        c = truth.classes[k]
        mine = (target.scores[:, c] > 0) & (target.boxes[:, c] == truth.boxes[k]).all(-1)
        assert int(mine.sum()) <= TOP_K
        alone = int((truth.classes == c).sum()) == 1
        if alone and bool(allowed[k].any()):
            assert bool(mine.any())


def test_concentric_boxes_of_other_classes_do_not_compete():
    """Nested truths of three classes are assigned as if each were alone: the point of the head."""
    scores, boxes = _guess()
    rows = [(0, 20, 10, 120, 110), (1, 32, 22, 108, 98), (2, 52, 42, 88, 78)]
    together = assign(scores, boxes, _truth(*rows), CENTERS, STRIDES)
    for c, row in enumerate(rows):
        alone = assign(scores, boxes, _truth(row), CENTERS, STRIDES)
        torch.testing.assert_close(together.scores[:, c], alone.scores[:, c])


def test_the_best_cell_aims_at_its_own_overlap():
    """The highest target score of a box is the highest overlap that its cells reach."""
    scores, boxes = _guess()
    truth = _truth((1, 30, 30, 90, 90))
    target = assign(scores, boxes, truth, CENTERS, STRIDES)
    cells = target.scores[:, 1] > 0
    overlap = box_iou(boxes[cells, 1], truth.boxes)
    assert float(target.scores[:, 1].max()) == pytest.approx(float(overlap.max()), rel=1e-3)


def test_a_perfect_cell_wins():
    """A cell that scores high with the true box gets the highest target."""
    scores, boxes = _guess()
    truth = _truth((0, 40, 40, 100, 90))
    inside = torch.nonzero(candidates(truth.boxes, CENTERS, STRIDES)[0]).flatten()
    best = int(inside[len(inside) // 3])
    scores[best, 0], boxes[best, 0] = 0.99, truth.boxes[0]
    target = assign(scores, boxes, truth, CENTERS, STRIDES)
    assert int(target.scores[:, 0].argmax()) == best
    assert float(target.scores[best, 0]) == pytest.approx(1.0, abs=1e-3)


def test_a_box_smaller_than_a_cell_still_has_one():
    """Far targets: a 3 px box between the centres of the finest cells is learnt by a neighbour."""
    truth = _truth((2, 44.0, 44.0, 47.0, 47.0))
    scores, boxes = _guess()
    target = assign(scores, boxes, truth, CENTERS, STRIDES)
    taught = torch.nonzero(target.scores[:, 2]).flatten()
    assert len(taught) >= 1
    assert bool((STRIDES[taught] == 8).all())


def test_an_ignored_box_neither_teaches_nor_punishes():
    """Its cells have no target and do not count, in its class alone."""
    scores, boxes = _guess()
    target = assign(scores, boxes, _truth((1, 20, 20, 90, 90), ignore=(0,)), CENTERS, STRIDES)
    inside = candidates(torch.tensor([[20.0, 20, 90, 90]]), CENTERS, STRIDES)[0]
    assert float(target.scores.sum()) == 0
    assert torch.equal(~target.counts[:, 1], inside)
    assert bool(target.counts[:, [0, 2]].all())


def test_of_two_boxes_of_a_class_a_cell_takes_the_nearer():
    """Overlapping truths of one class share no cell."""
    truth = _truth((0, 10, 10, 90, 90), (0, 60, 40, 140, 120))
    scores, boxes = _guess()
    target = assign(scores, boxes, truth, CENTERS, STRIDES)
    for cell in torch.nonzero(target.scores[:, 0]).flatten():
        assert any(torch.equal(target.boxes[cell, 0], b) for b in truth.boxes)


def test_an_empty_picture_has_no_targets():
    """Everything counts as background."""
    scores, boxes = _guess()
    target = assign(scores, boxes, _truth(), CENTERS, STRIDES)
    assert float(target.scores.sum()) == 0
    assert bool(target.counts.all())
