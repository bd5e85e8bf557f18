"""Everything that a training step changes."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from torch import nn

from detector_training.datasets.sample import CLASSES
from detector_training.errors import TrainingError
from detector_training.training.settings import TrainSettings
from edge_service.detector.net import NetConfig, TargetNet


@dataclass(slots=True)
class State:
    """Where a run stands."""

    net: TargetNet
    average: TargetNet
    optimizer: torch.optim.AdamW
    step: int = 0
    images: int = 0
    elapsed_s: float = 0.0
    best: float = -1.0
    """Highest validation score so far; below 0: none yet."""
    best_step: int = 0
    since_best: int = 0
    """Scores since then that were not better."""

    def is_finite(self) -> bool:
        """Whether all weights are numbers."""
        return all(bool(torch.isfinite(t).all()) for t in self.net.state_dict().values())


def fresh_state(settings: TrainSettings, start: TargetNet | None = None) -> State:
    """A net before its first step: from chance, or a copy of ``start``.

    Raises:
        TrainingError: ``start`` has another width than the settings.
    """
    net = TargetNet(NetConfig(CLASSES, settings.width))
    if start is not None:
        if start.config != net.config:
            raise TrainingError(
                f"the weights to start from have width {start.config.width}, "
                f"the settings say {settings.width}"
            )
        net.load_state_dict(start.state_dict())
    net = net.to(settings.device)
    net = net.to(memory_format=torch.channels_last)  # type: ignore[call-overload] # torch's stub
    decayed = [p for p in net.parameters() if p.ndim > 1]
    others = [p for p in net.parameters() if p.ndim <= 1]
    optimizer = torch.optim.AdamW(
        [
            {"params": decayed, "weight_decay": settings.weight_decay},
            {"params": others, "weight_decay": 0.0},
        ],
        lr=settings.learning_rate,
        betas=(0.9, 0.99),
    )
    average = copy.deepcopy(net).eval()
    net.train()
    if settings.keep_norms:
        for part in net.modules():
            if isinstance(part, nn.BatchNorm2d):
                part.eval()
    return State(net, average, optimizer)
