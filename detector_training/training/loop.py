"""The training loop: AdamW, warm-up and cosine, a moving average of the weights, whole resume."""

from __future__ import annotations

import copy
import csv
import math
import os
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn

from detector_training.datasets.sample import CLASSES, Sample
from detector_training.errors import TrainingError
from detector_training.training.batches import Batch, BatchSource, prefetched
from detector_training.training.loss import Loss
from detector_training.training.replicas import Replicas
from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.weights import save_weights

CHECKPOINT = "checkpoint.pt"
WEIGHTS = "weights.safetensors"
LOG = "log.csv"
LOG_FIELDS = ("step", "images", "elapsed_s", "learning_rate", "loss", "score_loss", "box_loss")

WARM_UP_STEPS = 150
FINAL_RATE = 0.02
"""Learning rate at the end, as a share of the highest."""
AVERAGE_DECAY = 0.998
GRADIENT_LIMIT = 10.0


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """What a run is made with; a resumed run must have the same.

    Raises:
        TrainingError: a number is out of bounds, or not exactly one of minutes and epochs is given.
    """

    minutes: float | None = None
    """Length of the run; its schedule follows the clock, so it is not reproducible to the bit."""
    epochs: int | None = None
    """Length of the run in pictures per data set size; reproducible with the seed."""
    seed: int = 0
    width: int = 16
    learning_rate: float = 2e-3
    weight_decay: float = 0.02
    batch_pixels: int = 8 * 320 * 256
    """Pixels of a batch; larger crops come in smaller batches."""
    target: str = "bullseye-400"
    bfloat16: bool = True
    workers: int = 1
    """CPUs to use; the result depends on it, since each norms its own share of a batch."""
    checkpoint_steps: int = 100

    def __post_init__(self) -> None:
        if (self.minutes is None) == (self.epochs is None):
            raise TrainingError("give either --minutes or --epochs")
        if self.minutes is not None and not 0 < self.minutes <= 60 * 24 * 14:
            raise TrainingError(f"minutes = {self.minutes} is not in (0, 20160]")
        if self.epochs is not None and not 0 < self.epochs <= 100_000:
            raise TrainingError(f"epochs = {self.epochs} is not in [1, 100000]")
        if not 0 <= self.seed < 1 << 63:
            raise TrainingError(f"seed = {self.seed} is not in [0, 2^63)")
        if not 1 <= self.workers <= 256:
            raise TrainingError(f"workers = {self.workers} is not in [1, 256]")
        if not 0 < self.learning_rate <= 1:
            raise TrainingError(f"learning rate = {self.learning_rate} is not in (0, 1]")


class Progress(NamedTuple):
    """Where a run stands, for a progress bar."""

    step: int
    images: int
    share: float
    """Of the run that is done, in [0, 1]."""
    loss: float


@dataclass(slots=True)
class _State:
    """Everything that a step changes."""

    net: TargetNet
    average: TargetNet
    optimizer: torch.optim.AdamW
    step: int = 0
    images: int = 0
    elapsed_s: float = 0.0


def train(
    samples: tuple[Sample, ...],
    run: Path,
    settings: TrainSettings,
    *,
    resume: bool = False,
    report: Callable[[Progress], None] = lambda _: None,
) -> Path:
    """Train a net on a data set and leave its averaged weights in ``run``.

    ``run`` gets ``checkpoint.pt`` (to resume), ``weights.safetensors`` and ``log.csv``; all are
    replaced whole, so that a kill at any moment leaves a run that can go on.

    Args:
        samples: The training set.
        run: Folder of the run; made when missing.
        settings: How to train.
        resume: Go on where the run's checkpoint stands.
        report: Called after every step.

    Returns:
        The path of the weights.

    Raises:
        TrainingError: the run exists and ``resume`` is false, or its checkpoint does not fit.
    """
    checkpoint = run / CHECKPOINT
    if checkpoint.exists() and not resume:
        raise TrainingError(f"{run} holds a run; give --resume or another folder")
    run.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(settings.seed)
    state = _fresh_state(settings)
    if checkpoint.exists():
        _load(checkpoint, state, settings)
    _trim_log(run / LOG, state.step)
    source = BatchSource(samples, settings.batch_pixels, settings.seed)
    started = time.monotonic() - state.elapsed_s
    with (
        closing(prefetched(source, state.step)) as batches,
        Replicas(state.net, settings.workers, settings.bfloat16) as replicas,
    ):
        while (share := _share_done(state, len(samples), settings)) < 1:
            batch = next(batches)
            rate = settings.learning_rate * schedule(share, state.step)
            loss = train_step(state.net, replicas, state.optimizer, batch, rate)
            if not math.isfinite(float(loss.total)):
                raise TrainingError(
                    f"the loss is {float(loss.total)} at step {state.step}; lower --learning-rate"
                )
            state.step += 1
            state.images += len(batch.truths)
            state.elapsed_s = time.monotonic() - started
            update_average(state.average, state.net, state.step)
            _log(run / LOG, state, rate, loss)
            report(Progress(state.step, state.images, share, float(loss.total)))
            if state.step % settings.checkpoint_steps == 0:
                _save(run, state, settings)
    _save(run, state, settings)
    return run / WEIGHTS


def schedule(share: float, step: int) -> float:
    """Learning rate as a share of the highest: linear warm-up, then half a cosine."""
    cosine = FINAL_RATE + (1 - FINAL_RATE) * (1 + math.cos(math.pi * min(share, 1.0))) / 2
    return cosine * min((step + 1) / WARM_UP_STEPS, 1.0)


def train_step(
    net: TargetNet,
    replicas: Replicas,
    optimizer: torch.optim.Optimizer,
    batch: Batch,
    learning_rate: float,
) -> Loss:
    """One step down the gradient; the loss is the one before the step."""
    for group in optimizer.param_groups:
        group["lr"] = learning_rate
    loss = replicas.backward(batch)
    nn.utils.clip_grad_norm_(net.parameters(), GRADIENT_LIMIT)
    optimizer.step()
    return loss


@torch.no_grad()
def update_average(average: TargetNet, net: TargetNet, step: int) -> None:
    """Move the averaged weights towards the net's; fast in the beginning."""
    decay = AVERAGE_DECAY * (1 - math.exp(-step / 300))
    for mean, new in zip(average.state_dict().values(), net.state_dict().values(), strict=True):
        if mean.dtype.is_floating_point:
            mean.lerp_(new, 1 - decay)


def _fresh_state(settings: TrainSettings) -> _State:
    net = TargetNet(NetConfig(CLASSES, settings.width))
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
    return _State(net.train(), copy.deepcopy(net).eval(), optimizer)


def _share_done(state: _State, n_samples: int, settings: TrainSettings) -> float:
    if settings.minutes is not None:
        return state.elapsed_s / (60 * settings.minutes)
    assert settings.epochs is not None
    return state.images / (settings.epochs * n_samples)


def _comparable(settings: TrainSettings) -> dict[str, Any]:
    """What must not change between a run and its resumption (a longer run is a fair wish)."""
    fixed = asdict(settings)
    for free in ("minutes", "epochs", "checkpoint_steps", "workers"):
        del fixed[free]
    return fixed


def _save(run: Path, state: _State, settings: TrainSettings) -> None:
    part = run / (CHECKPOINT + ".part")
    torch.save(
        {
            "settings": _comparable(settings),
            "net": state.net.state_dict(),
            "average": state.average.state_dict(),
            "optimizer": state.optimizer.state_dict(),
            "step": state.step,
            "images": state.images,
            "elapsed_s": state.elapsed_s,
        },
        part,
    )
    os.replace(part, run / CHECKPOINT)
    save_weights(run / WEIGHTS, state.average, settings.target)


def _load(path: Path, state: _State, settings: TrainSettings) -> None:
    try:
        saved: dict[str, Any] = torch.load(path, weights_only=True)
        was, wanted = saved["settings"], _comparable(settings)
        if was != wanted:
            changed = sorted(k for k in wanted if was.get(k) != wanted[k])
            raise TrainingError(f"{path} was made with another {', '.join(changed)}")
        state.net.load_state_dict(saved["net"])
        state.average.load_state_dict(saved["average"])
        state.optimizer.load_state_dict(saved["optimizer"])
        state.step, state.images = int(saved["step"]), int(saved["images"])
        state.elapsed_s = float(saved["elapsed_s"])
    except (OSError, RuntimeError, KeyError, ValueError, EOFError) as error:
        raise TrainingError(f"checkpoint {path} cannot be resumed: {error}") from None


def _trim_log(path: Path, step: int) -> None:
    """Drop the lines after the checkpoint: those steps will be done again."""
    rows: list[dict[str, str]] = []
    if path.exists():
        with path.open(newline="") as file:
            rows = [r for r in csv.DictReader(file) if r["loss"] and int(r["step"]) <= step]
    part = path.with_name(path.name + ".part")
    with part.open("w", newline="") as file:
        writer = csv.DictWriter(file, LOG_FIELDS, extrasaction="ignore", restval="")
        writer.writeheader()
        writer.writerows(rows)
    os.replace(part, path)


def _log(path: Path, state: _State, rate: float, loss: Loss) -> None:
    with path.open("a", newline="") as file:
        csv.writer(file).writerow(
            (
                state.step,
                state.images,
                f"{state.elapsed_s:.1f}",
                f"{rate:.6g}",
                *(f"{float(part):.5g}" for part in loss),
            )
        )
