"""The gradient of a batch, or of a part of it, where the net lies."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Protocol

import torch
from torch import Tensor

from detector_training.training.assign import Truth
from detector_training.training.batches import Batch
from detector_training.training.loss import Loss, detection_loss
from edge_service.detector.boxes import cell_centers
from edge_service.detector.net import TargetNet


class Gradient(Protocol):
    """Leaves the gradient of a batch in a net's parameters; a context manager."""

    def backward(self, batch: Batch) -> Loss:
        """The loss of the batch; its gradient is left in the net."""
        ...

    def __enter__(self) -> Gradient:
        """Begin."""
        ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give back what was taken."""
        ...


def backward_part(
    net: TargetNet, images: Tensor, truths: Sequence[Truth], whole: int, bfloat16: bool
) -> Loss:
    """Gradient and loss of a share of a batch, weighted by its size.

    Args:
        net: Gets the gradient added to its parameters' own.
        images: (B, 3, H, W) uint8, anywhere.
        truths: B entries, anywhere.
        whole: Pictures of the whole batch.
        bfloat16: Whether the convolutions compute in bf16.
    """
    place = next(net.parameters()).device
    images = images.to(place, non_blocking=True)
    pixels = images.contiguous(memory_format=torch.channels_last).float() / 255
    centers, strides = (t.to(place) for t in cell_centers(pixels.shape[2], pixels.shape[3]))
    with torch.autocast(place.type, torch.bfloat16, enabled=bfloat16):
        prediction = net(pixels)
    weight = len(truths) / whole
    moved = [Truth(*(t.to(place) for t in truth)) for truth in truths]
    loss = detection_loss(prediction, moved, centers, strides)
    (weight * loss.total).backward()  # type: ignore[no-untyped-call] # torch leaves it untyped
    return Loss(*(weight * part.detach() for part in loss))


class InOnePiece:
    """The whole batch at once: a GPU fills itself, and the norms see all pictures."""

    def __init__(self, net: TargetNet, bfloat16: bool) -> None:
        self._net = net
        self._bfloat16 = bfloat16

    def __enter__(self) -> InOnePiece:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing was taken."""

    def backward(self, batch: Batch) -> Loss:
        """See ``Gradient.backward``."""
        self._net.zero_grad(set_to_none=True)
        count = len(batch.truths)
        return backward_part(self._net, batch.images, batch.truths, count, self._bfloat16)
