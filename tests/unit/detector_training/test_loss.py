"""CIoU against the published formula and finite differences; what the loss rewards."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from detector_training.training.assign import Truth
from detector_training.training.loss import ciou, detection_loss
from edge_service.detector.boxes import cell_centers
from edge_service.detector.net import Prediction


def _plain_ciou(a, b):
    """Zheng et al. 2020, Eq. (7)-(11), in plain Python."""
    w = max(0.0, min(a[2], b[2]) - max(a[0], b[0]))
    h = max(0.0, min(a[3], b[3]) - max(a[1], b[1]))
    wa, ha, wb, hb = a[2] - a[0], a[3] - a[1], b[2] - b[0], b[3] - b[1]
    iou = w * h / (wa * ha + wb * hb - w * h)
    rho2 = ((a[0] + a[2] - b[0] - b[2]) / 2) ** 2 + ((a[1] + a[3] - b[1] - b[3]) / 2) ** 2
    c2 = (max(a[2], b[2]) - min(a[0], b[0])) ** 2 + (max(a[3], b[3]) - min(a[1], b[1])) ** 2
    v = 4 / math.pi**2 * (math.atan(wb / hb) - math.atan(wa / ha)) ** 2
    alpha = v / (1 - iou + v) if v > 0 else 0.0
    return iou - rho2 / c2 - alpha * v


@st.composite
def _box(draw):
    x, y = draw(st.floats(-50, 50)), draw(st.floats(-50, 50))
    return [x, y, x + draw(st.floats(1, 80)), y + draw(st.floats(1, 80))]


@given(a=_box(), b=_box())
@settings(max_examples=150, deadline=None)
def test_ciou_is_the_published_formula(a, b):
    """Any two boxes, apart or nested."""
    got = float(ciou(torch.tensor(a, dtype=torch.float64), torch.tensor(b, dtype=torch.float64)))
    assert got == pytest.approx(_plain_ciou(a, b), abs=1e-5)


def test_ciou_of_a_box_with_itself_is_one():
    """Nothing left to improve."""
    box = torch.tensor([3.0, 4, 50, 20])
    assert float(ciou(box, box)) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("a", [[0.0, 0, 30, 20], [60.0, 60, 90, 100], [12.0, 12, 20, 18]])
def test_gradient_is_that_of_finite_differences(a):
    """Overlapping, apart, nested; boxes of one aspect, where the weight has no derivative."""
    b = torch.tensor([10.0, 8, 40, 28], dtype=torch.float64)
    x = torch.tensor(a, dtype=torch.float64)
    ratio = (b[3] - b[1]) / (b[2] - b[0])
    x[3] = x[1] + (x[2] - x[0]) * ratio  # same aspect: the term and its weight vanish
    x.requires_grad_(True)
    (got,) = torch.autograd.grad(ciou(x, b), x)
    step = 1e-5
    for i in range(4):
        d = torch.zeros(4, dtype=torch.float64)
        d[i] = step
        with torch.no_grad():
            slope = (ciou(x + d, b) - ciou(x - d, b)) / (2 * step)
        assert float(got[i]) == pytest.approx(float(slope), abs=1e-5)


def test_boxes_apart_are_drawn_together():
    """Without any overlap the gradient still moves the box towards the truth."""
    a = torch.tensor([0.0, 0, 10, 10], requires_grad=True)
    (gradient,) = torch.autograd.grad(ciou(a, torch.tensor([50.0, 0, 60, 10])), a)
    assert float(gradient[0] + gradient[2]) > 0  # to the right


def _prediction(level, truth_box, good):
    """A net that is quite sure of the right cells (or of the wrong ones)."""
    centers, strides = cell_centers(64, 64)
    box = torch.tensor(truth_box)
    inside = ((centers > box[:2]) & (centers < box[2:])).all(-1)
    logits = torch.full((1, len(centers), 3), -6.0)
    logits[0, inside if good else ~inside, level] = 4.0
    distances = torch.cat((centers - box[:2], box[2:] - centers), -1).clamp_min(0.5)
    return Prediction(logits, distances[None, :, None].repeat(1, 1, 3, 1)), centers, strides


def test_being_right_costs_less_than_being_wrong():
    """Scores on the target and its true box against scores everywhere else."""
    truth = [Truth(torch.tensor([[16.0, 16, 48, 48]]), torch.tensor([1]), torch.tensor([False]))]
    right = detection_loss(*_shuffle(_prediction(1, [16.0, 16, 48, 48], good=True), truth))
    wrong = detection_loss(*_shuffle(_prediction(1, [16.0, 16, 48, 48], good=False), truth))
    assert float(right.total) < 0.3 * float(wrong.total)
    assert float(right.box) < 0.01


def _shuffle(made, truth):
    prediction, centers, strides = made
    return prediction, truth, centers, strides


def test_ignored_boxes_add_nothing():
    """A score on a box that is to be ignored costs nothing."""
    box = torch.tensor([[16.0, 16, 48, 48]])
    prediction, centers, strides = _prediction(1, [16.0, 16, 48, 48], good=True)
    ignored = [Truth(box, torch.tensor([1]), torch.tensor([True]))]
    absent = [
        Truth(box[:0], torch.tensor([], dtype=torch.long), torch.tensor([], dtype=torch.bool))
    ]
    free = detection_loss(prediction, ignored, centers, strides)
    costly = detection_loss(prediction, absent, centers, strides)
    assert float(free.total) < 0.1 * float(costly.total)
