"""Non-maximum suppression of one class's boxes, and the overlap that it goes by."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def pairwise_iou(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Intersection over union (A, B) of boxes (A, 4) and (B, 4), x0, y0, x1, y1."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    overlap = np.prod(np.clip(high - low, 0, None), axis=-1)
    area_a = np.prod(np.clip(a[:, 2:] - a[:, :2], 0, None), axis=-1)
    area_b = np.prod(np.clip(b[:, 2:] - b[:, :2], 0, None), axis=-1)
    union = area_a[:, None] + area_b[None, :] - overlap
    return np.asarray(overlap / np.maximum(union, np.finfo(np.float32).tiny), np.float32)


def suppress(
    boxes: NDArray[np.float32],
    scores: NDArray[np.float32],
    iou_threshold: float,
    max_boxes: int,
) -> NDArray[np.intp]:
    """Indices of the boxes that stay, best first.

    Greedy: the best box removes all that overlap it by more than the threshold, and so on. The
    overlaps are computed in one go; the loop runs over the boxes that stay, not over all pairs.

    Args:
        boxes: (N, 4).
        scores: (N,); equal scores keep their order.
        iou_threshold: In [0, 1].
        max_boxes: At most this many stay.
    """
    order = np.argsort(-scores, kind="stable")
    overlaps = pairwise_iou(boxes[order], boxes[order]) > iou_threshold
    alive = np.ones(len(order), bool)
    kept: list[int] = []
    while alive.any() and len(kept) < max_boxes:
        best = int(np.argmax(alive))
        kept.append(best)
        alive &= ~overlaps[best]
        alive[best] = False
    return order[kept]
