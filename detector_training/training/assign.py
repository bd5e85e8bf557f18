"""Which cell learns which box: task-aligned assignment, for each class on its own.

A cell's metric for a true box is ``score^a * iou^b``; the best cells inside the box become its
positives, and their target score is the metric scaled so that the best cell aims at its own IoU
(Feng et al., "TOOD: Task-aligned One-stage Object Detection", 2021). Since every class has its own
score and distances, concentric boxes of different classes never compete for a cell.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

TOP_K = 10
SCORE_POWER = 0.5
IOU_POWER = 6.0
EPSILON = 1e-9


class Truth(NamedTuple):
    """The true boxes of one picture; M is their number."""

    boxes: Tensor  # (M, 4)
    """x0, y0, x1, y1 [px]; may lie partly outside the picture."""
    classes: Tensor  # (M,) int64
    ignore: Tensor  # (M,) bool
    """Neither to be found nor to be missed (too small, too little of it visible)."""


class Assignment(NamedTuple):
    """What every cell shall answer; N cells, C classes."""

    scores: Tensor  # (N, C)
    """Target score; 0 where no box is assigned."""
    boxes: Tensor  # (N, C, 4)
    """Target box [px]; meaningless where the score is 0."""
    counts: Tensor  # (N, C) bool
    """False where the cell's score must not be punished."""


def box_iou(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union of boxes (..., 4) and (..., 4), broadcast."""
    low = torch.maximum(a[..., :2], b[..., :2])
    high = torch.minimum(a[..., 2:], b[..., 2:])
    overlap = (high - low).clamp_min(0).prod(-1)
    area_a = (a[..., 2:] - a[..., :2]).clamp_min(0).prod(-1)
    area_b = (b[..., 2:] - b[..., :2]).clamp_min(0).prod(-1)
    return overlap / (area_a + area_b - overlap + EPSILON)


def candidates(boxes: Tensor, centers: Tensor, strides: Tensor) -> Tensor:
    """Mask (M, N) of the cells that may learn each box.

    Those whose centre lies inside the box; for a box that is smaller than a cell also those within
    half a stride of its centre, so that every box has one.
    """
    u, v = centers[:, 0], centers[:, 1]
    x0, y0, x1, y1 = (boxes[:, i, None] for i in range(4))
    inside = (u > x0) & (u < x1) & (v > y0) & (v < y1)
    finest = strides == strides.min()
    half = strides / 2
    near = ((u - (x0 + x1) / 2).abs() <= half) & ((v - (y0 + y1) / 2).abs() <= half)
    return inside | (near & finest)


@torch.no_grad()
def assign(
    scores: Tensor, boxes: Tensor, truth: Truth, centers: Tensor, strides: Tensor
) -> Assignment:
    """Targets of all cells of one picture.

    Args:
        scores: (N, C) after the sigmoid.
        boxes: (N, C, 4) predicted [px].
        truth: The M true boxes.
        centers: (N, 2) cell centres [px].
        strides: (N,) [px].
    """
    n, c = scores.shape
    where = scores.device
    target = Assignment(
        torch.zeros(n, c, device=where),
        torch.zeros(n, c, 4, device=where),
        torch.ones(n, c, dtype=torch.bool, device=where),
    )
    if not len(truth.boxes):
        return target
    allowed = candidates(truth.boxes, centers, strides)
    for k in torch.nonzero(truth.ignore).flatten().tolist():
        target.counts[:, truth.classes[k]] &= ~allowed[k]
    keep = ~truth.ignore
    true_boxes, classes, allowed = truth.boxes[keep], truth.classes[keep], allowed[keep]
    if not len(true_boxes):
        return target
    # (M, N): what each cell says in the class of each true box
    overlap = box_iou(boxes[:, classes].transpose(0, 1), true_boxes[:, None])
    metric = scores[:, classes].T.pow(SCORE_POWER) * overlap.pow(IOU_POWER)
    # The tiny term lets a fresh net, whose boxes overlap nothing, start from the nearest cells
    to_center = (centers[None] - (true_boxes[:, None, :2] + true_boxes[:, None, 2:]) / 2).norm(
        dim=-1
    )
    ranked = torch.where(allowed, metric + EPSILON / (1 + to_center), torch.zeros_like(metric))
    best = ranked.topk(min(TOP_K, n), dim=1)
    positive = torch.zeros_like(allowed).scatter_(1, best.indices, best.values > 0)
    for k in range(len(true_boxes)):
        rivals = (classes == classes[k]) & (torch.arange(len(classes), device=where) != k)
        if rivals.any():  # a cell that two boxes of one class want goes to the better overlap
            strongest = torch.where(positive[rivals], overlap[rivals], -1.0).amax(0)
            positive[k] &= overlap[k] >= strongest
    for k in range(len(true_boxes)):
        cells = positive[k]
        if not cells.any():
            continue
        m, iou = metric[k, cells], overlap[k, cells]
        target.scores[cells, classes[k]] = (m / (m.max() + EPSILON) * iou.max()).clamp_min(0.01)
        target.boxes[cells, classes[k]] = true_boxes[k]
        target.counts[cells, classes[k]] = True
    return target
