"""What a run is made with: from scratch, or from weights that know the target already."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias

from detector_training.errors import TrainingError

Device: TypeAlias = Literal["cpu", "cuda"]

WIDTH = 16
LEARNING_RATE = 2e-3
WARM_UP_STEPS = 150
PICTURES = 80_000
"""Default length from scratch, in pictures seen; under 2 hours at 13 pictures a second."""

FINE_TUNE_LEARNING_RATE = 3e-4
FINE_TUNE_WARM_UP_STEPS = 30
FINE_TUNE_PICTURES = 4_000
"""Default length of fine-tuning; half mixed in, each of 50 pictures is seen 40 times: minutes."""

MIX_SHARE = 0.5
VALIDATIONS = 10
VAL_PICTURES = 150

_FREE = ("minutes", "epochs", "pictures", "checkpoint_steps", "workers", "device", "patience")
"""What may change when a run is resumed: a longer run, other hardware, more patience."""


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """What a run is made with; a resumed run must have the same but for its length.

    Raises:
        TrainingError: a number is out of bounds, or not exactly one length is given.
    """

    minutes: float | None = None
    """Length of the run; its schedule follows the clock, so it is not reproducible to the bit."""
    epochs: int | None = None
    """Length of the run in pictures per data set size; reproducible with the seed."""
    seed: int = 0
    width: int = WIDTH
    learning_rate: float = LEARNING_RATE
    weight_decay: float = 0.02
    batch_pixels: int = 8 * 320 * 256
    """Pixels of a batch; larger crops come in smaller batches."""
    target: str = "bullseye-400"
    bfloat16: bool = True
    workers: int = 1
    """CPUs to use; the result depends on it, since each norms its own share of a batch."""
    checkpoint_steps: int = 100
    pictures: int | None = None
    """Length of the run in pictures seen; reproducible with the seed."""
    warm_up_steps: int = WARM_UP_STEPS
    keep_norms: bool = False
    """The norms go on with the statistics that they came with: few pictures give bad ones."""
    mix_share: float = 0.0
    """Share of crops that come from the other data set, so that what it teaches stays."""
    validations: int = VALIDATIONS
    """How often the averaged weights are scored on the validation set, evenly over the run."""
    val_pictures: int = VAL_PICTURES
    """At most so many pictures of it, evenly drawn from the set."""
    patience: int | None = None
    """Stop after so many scores without a better one."""
    device: Device = "cpu"

    def __post_init__(self) -> None:
        if [self.minutes, self.epochs, self.pictures].count(None) != 2:
            raise TrainingError("give either --minutes or --epochs or --pictures")
        _within("minutes", self.minutes, 0, 60 * 24 * 14, open_below=True)
        _within("epochs", self.epochs, 1, 100_000)
        _within("pictures", self.pictures, 1, 10**9)
        _within("seed", self.seed, 0, (1 << 63) - 1)
        _within("workers", self.workers, 1, 256)
        _within("learning rate", self.learning_rate, 0, 1, open_below=True)
        _within("mix share", self.mix_share, 0, 0.95)
        _within("validations", self.validations, 1, 1000)
        _within("val pictures", self.val_pictures, 1, 100_000)
        _within("patience", self.patience, 1, 1000)

    def comparable(self) -> dict[str, Any]:
        """What must not change between a run and its resumption."""
        return {k: v for k, v in asdict(self).items() if k not in _FREE}

    def length(self, n_samples: int) -> int | None:
        """Pictures that will be seen; None where the clock decides."""
        return self.epochs * n_samples if self.epochs is not None else self.pictures


def _within(
    name: str, value: float | None, low: float, high: float, *, open_below: bool = False
) -> None:
    if value is None:
        return
    fits = math.isfinite(value) and low <= value <= high and not (open_below and value == low)
    if not fits:
        bracket = "(" if open_below else "["
        raise TrainingError(f"{name} = {value} is not in {bracket}{low}, {high}]")
