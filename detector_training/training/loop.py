"""The training loop: AdamW, warm-up and cosine, a moving average of the weights, whole resume."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch

from detector_training.datasets.sample import Sample
from detector_training.datasets.sheet import write_png
from detector_training.errors import DatasetError, NotFiniteError, TrainingError
from detector_training.training.batches import Batch, BatchSource, prefetched
from detector_training.training.checkpoint import load_checkpoint, save_checkpoint
from detector_training.training.gradient import Gradient, InOnePiece
from detector_training.training.log import LOG_FIELDS, append_log, trim_log
from detector_training.training.loss import Loss
from detector_training.training.pictures import draw_crops
from detector_training.training.replicas import Replicas
from detector_training.training.settings import WARM_UP_STEPS, TrainSettings
from detector_training.training.state import State, fresh_state
from detector_training.training.step import schedule, train_step, update_average
from detector_training.training.summary import fingerprint, summarise
from detector_training.training.validation import Validation, ValScore
from edge_service.detector.net import TargetNet
from edge_service.detector.weights import save_weights
from target_pose.target import load_round_target

CHECKPOINT = "checkpoint.safetensors"
WEIGHTS = "weights.safetensors"
LAST = "last.safetensors"
LOG = "log.csv"
CROPS = "crops.png"

NAMED = 12
"""Pictures of a bad batch that a message names."""

__all__ = [
    "CHECKPOINT",
    "CROPS",
    "LAST",
    "LOG",
    "LOG_FIELDS",
    "WARM_UP_STEPS",
    "WEIGHTS",
    "Progress",
    "Sets",
    "TrainSettings",
    "schedule",
    "train",
    "train_step",
    "update_average",
]


class Progress(NamedTuple):
    """Where a run stands, for a progress bar."""

    step: int
    images: int
    share: float
    """Of the run that is done, in [0, 1]."""
    loss: float
    val: ValScore | None = None
    """When the weights were scored in this step."""


@dataclass(frozen=True, slots=True)
class Sets:
    """What a run works with besides its training set."""

    start: TargetNet | None = None
    """Weights to start from; None: from chance."""
    mixed: tuple[Sample, ...] = ()
    """Another data set, of which ``mix_share`` of the crops are cut."""
    val: tuple[Sample, ...] = ()
    """Scored on the way; the best weights are kept."""


def train(
    samples: tuple[Sample, ...],
    run: Path,
    settings: TrainSettings,
    *,
    sets: Sets | None = None,
    resume: bool = False,
    report: Callable[[Progress], None] = lambda _: None,
    stop: Callable[[], bool] = lambda: False,
) -> Path:
    """Train a net on a data set and leave its averaged weights in ``run``.

    ``run`` gets ``checkpoint.safetensors`` (to resume), ``last.safetensors``,
    ``weights.safetensors`` (the best on ``sets.val`` where given, else the last), ``log.csv`` and
    ``crops.png``; each is replaced whole, so that a kill at any moment leaves a run that can go on.

    Args:
        samples: The training set.
        run: Folder of the run; made when missing.
        settings: How to train.
        sets: Where to start, what to mix in, what to score on.
        resume: Go on where the run's checkpoint stands.
        report: Called after every step.
        stop: Asked after every step; once true, the state is saved and KeyboardInterrupt raised.

    Returns:
        The path of the weights.

    Raises:
        TrainingError: the run exists and ``resume`` is false, its checkpoint does not fit, nothing
            can be learned from the data, a picture or the folder fails, or the loss is no number.
        KeyboardInterrupt: ``stop`` said so.
    """
    sets = sets or Sets()
    _check_folder(run, resume)
    summarise(samples)
    target = load_round_target(settings.target)
    validation = Validation(sets.val, target, settings.val_pictures) if sets.val else None
    torch.manual_seed(settings.seed)
    state = fresh_state(settings, sets.start)
    loop = _Run(run, settings, state, validation, target.name, _origin(samples, sets))
    if (run / CHECKPOINT).exists():
        load_checkpoint(run / CHECKPOINT, state, settings, loop.origin)
    source = BatchSource(
        samples, settings.batch_pixels, settings.seed, sets.mixed, settings.mix_share
    )
    if not state.step:
        write_png(run / CROPS, draw_crops(source))
    trim_log(run / LOG, state.step)
    with (
        closing(prefetched(source, state.step)) as batches,
        _gradient(state.net, settings) as gradient,
    ):
        loop.steps(batches, gradient, len(samples), report, stop)
    return run / WEIGHTS


@dataclass(slots=True)
class _Run:
    """The loop around the steps, and what it leaves in the folder."""

    folder: Path
    settings: TrainSettings
    state: State
    validation: Validation | None
    target: str
    """Its name; the settings may have the path of a file."""
    origin: str

    def steps(
        self,
        batches: Iterator[Batch],
        gradient: Gradient,
        n_samples: int,
        report: Callable[[Progress], None],
        stop: Callable[[], bool],
    ) -> None:
        """Step until the run is as long as it shall be, or does not get better any more."""
        state, settings = self.state, self.settings
        started = time.monotonic() - state.elapsed_s
        saved = -1
        share = _share_done(state, n_samples, settings)
        while share < 1 and not self._is_stale():
            batch = self._next(batches)
            rate = settings.learning_rate * schedule(share, state.step, settings.warm_up_steps)
            loss = self._step(gradient, batch, rate)
            state.step += 1
            state.images += len(batch.truths)
            state.elapsed_s = time.monotonic() - started
            update_average(state.average, state.net, state.step)
            before, share = share, _share_done(state, n_samples, settings)
            if (val := self._validate(before, share)) is not None:
                state.elapsed_s = time.monotonic() - started
                share = _share_done(state, n_samples, settings)
            append_log(self.folder / LOG, state, rate, loss, val)
            report(Progress(state.step, state.images, min(share, 1.0), float(loss.total), val))
            stopped = stop()
            if stopped or val is not None or state.step % settings.checkpoint_steps == 0:
                self.save()
                saved = state.step
            if stopped:
                raise KeyboardInterrupt
        if saved != state.step:
            self.save()

    def save(self) -> None:
        """Leave weights and checkpoint.

        Raises:
            TrainingError: they cannot be written, or are no numbers.
        """
        if not self.state.is_finite():
            raise TrainingError(
                f"the weights are no numbers after step {self.state.step}; {self._way_on()}"
            )
        names = (LAST,) if self.validation else (LAST, WEIGHTS)
        for name in names:
            self._write_weights(name)
        save_checkpoint(self.folder / CHECKPOINT, self.state, self.settings, self.origin)

    def _write_weights(self, name: str) -> None:
        path = self.folder / name
        try:
            save_weights(path, self.state.average, self.target)
        except OSError as error:
            path.with_name(path.name + ".part").unlink(missing_ok=True)
            raise TrainingError(f"cannot write {path}: {error.strerror or error}") from None

    def _next(self, batches: Iterator[Batch]) -> Batch:
        """The next batch; when a picture fails, what was learned so far is kept."""
        try:
            return next(batches)
        except DatasetError as error:
            if not self.state.step:
                raise
            self.save()
            raise DatasetError(
                f"{error}; step {self.state.step} is kept: mend the picture and --resume"
            ) from None

    def _step(self, gradient: Gradient, batch: Batch, rate: float) -> Loss:
        state = self.state
        try:
            return train_step(state.net, gradient, state.optimizer, batch, rate)
        except NotFiniteError as error:
            names = list(dict.fromkeys(str(p) for p in batch.pictures))
            more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
            raise NotFiniteError(
                f"{error} at step {state.step}, of {', '.join(names[:NAMED])}{more}; "
                f"{self._way_on()}"
            ) from None

    def _way_on(self) -> str:
        """What to do when numbers ran away."""
        rate = f"a --learning-rate below {self.settings.learning_rate:g}"
        if (self.folder / LAST).exists():
            return f"go on with --from {self.folder / LAST}, another --out and {rate}"
        return f"start anew with {rate}"

    def _validate(self, before: float, share: float) -> ValScore | None:
        """Score the averaged weights when a tick of the run has passed; keep them when best."""
        ticks = self.settings.validations
        if self.validation is None or int(before * ticks) == int(min(share, 1.0) * ticks):
            return None
        state = self.state
        score = self.validation.score(state.average)
        state.since_best = 0 if score.ap50_95 > state.best else state.since_best + 1
        if score.ap50_95 >= state.best:  # of equals the later: it has seen more
            state.best, state.best_step = score.ap50_95, state.step
            self._write_weights(WEIGHTS)
        return score

    def _is_stale(self) -> bool:
        patience = self.settings.patience
        return patience is not None and self.state.since_best >= patience


def _gradient(net: TargetNet, settings: TrainSettings) -> Gradient:
    if settings.device == "cuda":
        return InOnePiece(net, settings.bfloat16)
    return Replicas(net, settings.workers, settings.bfloat16)


def _share_done(state: State, n_samples: int, settings: TrainSettings) -> float:
    if settings.minutes is not None:
        return state.elapsed_s / (60 * settings.minutes)
    length = settings.length(n_samples)
    assert length is not None
    return state.images / length


def _check_folder(run: Path, resume: bool) -> None:
    try:
        if (run / CHECKPOINT).exists():
            if not resume:
                raise TrainingError(f"{run} holds a run; give --resume or another folder")
        elif (run / WEIGHTS).exists() or (run / LAST).exists():
            raise TrainingError(f"{run} holds weights but no {CHECKPOINT}; name another folder")
        run.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrainingError(f"cannot write to {run}: {error.strerror or error}") from None


def _origin(samples: tuple[Sample, ...], sets: Sets) -> str:
    """Digest of what a run is made from."""
    digest = hashlib.sha256()
    for part in (samples, sets.mixed, sets.val):
        digest.update(fingerprint(part).encode())
    if sets.start is not None:
        for name, tensor in sets.start.state_dict().items():
            digest.update(name.encode() + tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
