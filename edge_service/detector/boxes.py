"""From cells and distances to boxes in pixels, in torch for the training; ``grid`` in numpy.

Pixel (0, 0) is the centre of the first pixel.
"""

from __future__ import annotations

import torch
from torch import Tensor

from edge_service.detector.net import STRIDES


def cell_centers(height: int, width: int) -> tuple[Tensor, Tensor]:
    """Centres (N, 2) as (u, v) [px] and strides (N,) [px] of all cells, in the net's order.

    A cell of stride s covers s pixels, 0 to s - 1 the first, so its centre is at (s - 1) / 2.
    """
    centers, strides = [], []
    for stride in STRIDES:
        rows, columns = height // stride, width // stride
        v = torch.arange(rows, dtype=torch.float32) * stride + (stride - 1) / 2
        u = torch.arange(columns, dtype=torch.float32) * stride + (stride - 1) / 2
        vv, uu = torch.meshgrid(v, u, indexing="ij")
        centers.append(torch.stack((uu, vv), -1).reshape(-1, 2))
        strides.append(torch.full((rows * columns,), float(stride)))
    return torch.cat(centers), torch.cat(strides)


def decode(distances: Tensor, centers: Tensor) -> Tensor:
    """Boxes (..., N, C, 4) as x0, y0, x1, y1 [px] from distances of that shape and (N, 2)."""
    centers = centers[:, None, :]
    return torch.cat((centers - distances[..., :2], centers + distances[..., 2:]), -1)
