"""How good the averaged weights are while a run goes on: a few pictures, one thread, seconds."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch

from detector_training.datasets.sample import CLASSES, Sample
from detector_training.errors import TrainingError
from detector_training.evaluation.matching import (
    HIT_IOU,
    Counting,
    Outcome,
    candidate_outcome,
    level_outcome,
    match,
)
from detector_training.evaluation.precision_recall import IOU_STEPS, average_precision
from detector_training.evaluation.run import Find, run_detector
from edge_service.detector.detector import EngineDetector, Model
from edge_service.detector.layouts import CellLayout
from edge_service.detector.net import TargetNet
from edge_service.detector.torch_engine import CpuEngine
from target_pose.target import Level, Target

SCORE_THRESHOLD = 0.02
"""Low, so that the precision-recall curve is whole."""


class ValScore(NamedTuple):
    """Scores of one moment."""

    ap50_95: float
    """Mean over the levels that the pictures show: what the best weights are chosen by."""
    recall: float
    """Of whole targets, after the nesting check."""
    false_per_picture: float
    """Likewise."""


class Validation:
    """Scores nets on the same pictures again and again; not thread-safe by intent.

    Args:
        samples: The validation set.
        target: For the nesting check.
        most: So many of its pictures are looked at, evenly drawn in its order.

    Raises:
        TrainingError: no box of these pictures counts, so that there is nothing to score.
    """

    def __init__(self, samples: tuple[Sample, ...], target: Target, most: int) -> None:
        self.samples = evenly(samples, most)
        self._target = target
        counting = Counting()
        if not any(_truths(s, counting) for s in self.samples):
            raise TrainingError(
                f"--val: none of the boxes in {len(self.samples)} pictures counts "
                f"(at least {counting.min_px:g} px wide, {counting.min_visible:.0%} visible)"
            )

    def score(self, net: TargetNet) -> ValScore:
        """Look at every picture with a copy of the net, on the CPU.

        Raises:
            DatasetError: a picture cannot be read.
        """
        return val_score(self.finds(net))

    def finds(
        self, net: TargetNet, on_progress: Callable[[int], None] = lambda done: None
    ) -> tuple[Find, ...]:
        """What the net sees in each picture."""
        return run_detector(detector_of(net).detect, self.samples, self._target, on_progress)


def evenly(samples: tuple[Sample, ...], most: int) -> tuple[Sample, ...]:
    """At most so many, evenly drawn in their order: sets come sorted by site or condition."""
    if len(samples) <= most:
        return samples
    return tuple(samples[k * len(samples) // most] for k in range(most))


def detector_of(net: TargetNet) -> EngineDetector:
    """A detector around a net that is still trained, in fp32 on the CPU."""
    copied = TargetNet(net.config)
    copied.load_state_dict({name: t.detach().cpu() for name, t in net.state_dict().items()})
    engine = CpuEngine(copied.eval(), torch.float32)
    layout = CellLayout(tuple(Level(name) for name in CLASSES))
    model = Model("training", None, "", layout, None, {})
    return EngineDetector(engine, model, {"engine": "torch"}, SCORE_THRESHOLD)


def val_score(finds: tuple[Find, ...]) -> ValScore:
    """The scores of what was found; something in the pictures must count."""
    counting = Counting()
    means = []
    for level in Level:
        outcomes = [level_outcome(f.sample, f.detections, level, counting) for f in finds]
        values = [average_precision(outcomes, iou) for iou in IOU_STEPS]
        means += [np.mean([v for v in values if v is not None])] if values[0] is not None else []
    hits = truths = false = 0
    for f in finds:
        outcome = candidate_outcome(f.sample, f.candidates, counting)
        hit, ignored, _ = match(outcome, HIT_IOU)
        hits, truths = hits + int(hit.sum()), truths + int(outcome.counts.sum())
        false += int((~hit & ~ignored).sum())
    return ValScore(float(np.mean(means)), hits / max(truths, 1), false / len(finds))


def _truths(sample: Sample, counting: Counting) -> int:
    outcome: Outcome = candidate_outcome(sample, (), counting)
    return int(outcome.counts.sum())
