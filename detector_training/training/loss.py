"""What training minimises: cross-entropy of the scores and CIoU of the assigned boxes."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from detector_training.training.assign import Assignment, Truth, assign
from edge_service.detector.boxes import decode
from edge_service.detector.net import Prediction

SCORE_GAIN = 1.0
BOX_GAIN = 5.0
MIN_WEIGHT_PER_PICTURE = 4.0
"""The losses are divided by the sum of the target scores (about 15 in a picture with a target once
the net is good); never by less than this, or pictures without a target would rule the gradient."""
EPSILON = 1e-7


class Loss(NamedTuple):
    """The sum and its parts."""

    total: Tensor  # ()
    score: Tensor  # ()
    box: Tensor  # ()


def ciou(a: Tensor, b: Tensor) -> Tensor:
    """Complete IoU (...,) of boxes (..., 4): IoU less centre distance less aspect difference.

    Zheng et al., "Distance-IoU Loss" and its complete form, 2020. The weight of the aspect term
    carries no gradient, as there.
    """
    wa, ha = a[..., 2] - a[..., 0], a[..., 3] - a[..., 1]
    wb, hb = b[..., 2] - b[..., 0], b[..., 3] - b[..., 1]
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    overlap = (high - low).clamp_min(0).prod(-1)
    iou = overlap / (wa * ha + wb * hb - overlap + EPSILON)
    hull = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    diagonal2 = hull.square().sum(-1) + EPSILON
    apart2 = (a[..., :2] + a[..., 2:] - b[..., :2] - b[..., 2:]).square().sum(-1) / 4
    aspect = (torch.atan(wb / (hb + EPSILON)) - torch.atan(wa / (ha + EPSILON))).square()
    aspect = aspect * (4 / math.pi**2)
    with torch.no_grad():
        weight = aspect / (1 - iou + aspect + EPSILON)
    return iou - apart2 / diagonal2 - weight * aspect


def detection_loss(
    prediction: Prediction, truths: list[Truth], centers: Tensor, strides: Tensor
) -> Loss:
    """Loss of a batch.

    Args:
        prediction: Of B pictures.
        truths: B entries.
        centers: (N, 2) cell centres [px].
        strides: (N,) [px].
    """
    boxes = decode(prediction.distances, centers)
    scores = prediction.logits.detach().sigmoid()
    found = [
        assign(s, b, truth, centers, strides)
        for s, b, truth in zip(scores, boxes.detach(), truths, strict=True)
    ]
    target = Assignment(*(torch.stack(parts) for parts in zip(*found, strict=True)))
    weight_sum = target.scores.sum().clamp_min(MIN_WEIGHT_PER_PICTURE * len(truths))
    per_cell = torch.nn.functional.binary_cross_entropy_with_logits(
        prediction.logits, target.scores, reduction="none"
    )
    score = (per_cell * target.counts).sum() / weight_sum
    positive = target.scores > 0
    away = 1 - ciou(boxes[positive], target.boxes[positive])
    box = (away * target.scores[positive]).sum() / weight_sum
    return Loss(SCORE_GAIN * score + BOX_GAIN * box, score.detach(), box.detach())
