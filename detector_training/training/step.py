"""One step of the training, and how it changes over a run."""

from __future__ import annotations

import math

import torch
from torch import nn

from detector_training.errors import NotFiniteError
from detector_training.training.batches import Batch
from detector_training.training.gradient import Gradient
from detector_training.training.loss import Loss
from detector_training.training.settings import WARM_UP_STEPS
from edge_service.detector.net import TargetNet

FINAL_RATE = 0.02
"""Learning rate at the end, as a share of the highest."""
AVERAGE_DECAY = 0.998
GRADIENT_LIMIT = 10.0


def schedule(share: float, step: int, warm_up_steps: int = WARM_UP_STEPS) -> float:
    """Learning rate as a share of the highest: linear warm-up, then half a cosine."""
    cosine = FINAL_RATE + (1 - FINAL_RATE) * (1 + math.cos(math.pi * min(share, 1.0))) / 2
    return cosine * min((step + 1) / warm_up_steps, 1.0)


def train_step(
    net: TargetNet,
    gradient: Gradient,
    optimizer: torch.optim.Optimizer,
    batch: Batch,
    learning_rate: float,
) -> Loss:
    """One step down the gradient; the loss is the one before the step.

    Raises:
        NotFiniteError: the loss or the gradient is no number; no step was made.
    """
    for group in optimizer.param_groups:
        group["lr"] = learning_rate
    loss = gradient.backward(batch)
    norm = nn.utils.clip_grad_norm_(net.parameters(), GRADIENT_LIMIT)
    for name, value in (("loss", loss.total), ("gradient", norm)):
        if not math.isfinite(float(value)):
            raise NotFiniteError(f"the {name} is {float(value)}")
    optimizer.step()
    return loss


@torch.no_grad()
def update_average(average: TargetNet, net: TargetNet, step: int) -> None:
    """Move the averaged weights towards the net's; fast in the beginning."""
    decay = AVERAGE_DECAY * (1 - math.exp(-step / 300))
    for mean, new in zip(average.state_dict().values(), net.state_dict().values(), strict=True):
        if mean.dtype.is_floating_point:
            mean.lerp_(new, 1 - decay)
