"""Training batches: a pure function of seed and step, made in a thread beside the training."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from detector_training.datasets.sample import Sample, decode_image, read_bytes
from detector_training.training.assign import Truth
from detector_training.training.augment import Crop, augment

SIZES = ((256, 192), (320, 256), (448, 352), (640, 480))
"""Width and height of the crops [px]; all pictures of a batch share one."""
SIZE_SHARES = (0.4, 0.35, 0.15, 0.1)
"""Most crops are small: on a CPU the number of different ones seen is what counts."""

MAX_CACHE_BYTES = 2 << 30
"""Of compressed pictures that stay in memory; the rest is read again."""


class Batch(NamedTuple):
    """What one step learns from; B pictures."""

    images: Tensor  # (B, 3, H, W) uint8
    truths: list[Truth]
    pictures: tuple[Path, ...] = ()
    """Where each crop was cut from, for messages."""


class BatchSource:
    """Makes batch ``step`` of a run; the same seed and step give the same batch.

    Args:
        samples: The data set.
        batch_pixels: Pixels of a batch.
        seed: Of the run.
        mixed: Another data set, which
        mix_share: of all crops are cut from, by chance.
    """

    def __init__(
        self,
        samples: tuple[Sample, ...],
        batch_pixels: int,
        seed: int,
        mixed: tuple[Sample, ...] = (),
        mix_share: float = 0.0,
    ) -> None:
        self._own = len(samples)
        self._samples = samples + mixed
        self._mix_share = mix_share if mixed else 0.0
        self._batch_pixels = batch_pixels
        self._seed = seed
        self._cache: dict[int, bytes] = {}
        self._cached_bytes = 0

    def make(self, step: int) -> Batch:
        """The batch of a step: pictures drawn by chance, each cropped and augmented."""
        rng = np.random.default_rng((self._seed, step))
        size = SIZES[rng.choice(len(SIZES), p=SIZE_SHARES)]
        count = max(self._batch_pixels // (size[0] * size[1]), 1)
        indices = rng.integers(self._own, size=count)
        if self._mix_share:
            others = rng.integers(self._own, len(self._samples), size=count)
            indices = np.where(rng.random(count) < self._mix_share, others, indices)
        crops = [self._crop(int(i), size, rng) for i in indices]
        images = np.stack([c.image for c in crops])
        return Batch(
            torch.from_numpy(images).permute(0, 3, 1, 2),
            [_truth(c) for c in crops],
            tuple(self._samples[i].image for i in indices),
        )

    def _crop(self, index: int, size: tuple[int, int], rng: np.random.Generator) -> Crop:
        sample = self._samples[index]
        image = decode_image(sample, self._read(index))
        return augment(image, sample.boxes, sample.classes, sample.visible, size, rng)

    def _read(self, index: int) -> bytes:
        if (data := self._cache.get(index)) is None:
            data = read_bytes(self._samples[index].image)
            if self._cached_bytes + len(data) <= MAX_CACHE_BYTES:
                self._cache[index] = data
                self._cached_bytes += len(data)
        return data


def _truth(crop: Crop) -> Truth:
    return Truth(
        torch.from_numpy(crop.boxes), torch.from_numpy(crop.classes), torch.from_numpy(crop.ignore)
    )


def prefetched(source: BatchSource, first: int, depth: int = 3) -> Generator[Batch]:
    """Batches from step ``first`` on, made ahead by one thread; ends it when closed.

    Raises:
        TrainingError: what making a batch raised, in the caller's thread.
    """
    ready: queue.Queue[Batch | Exception] = queue.Queue(depth)
    stop = threading.Event()

    def work() -> None:
        step = first
        item: Batch | Exception
        while not stop.is_set():
            try:
                item = source.make(step)
            except Exception as error:  # the thread's border: it goes to the caller, who raises it
                item = error
            step += 1
            while not stop.is_set():
                try:
                    ready.put(item, timeout=0.2)
                    break
                except queue.Full:
                    continue
            if isinstance(item, Exception):
                return

    thread = threading.Thread(target=work, name="batches", daemon=True)
    thread.start()
    try:
        while True:
            item = ready.get()
            if isinstance(item, Exception):
                raise item
            yield item
    finally:
        stop.set()
        thread.join()
