"""PyTorch as the engine, on a CPU or on a GPU."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Literal, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from edge_service.detector.layouts import Outputs
from edge_service.detector.net import TargetNet
from edge_service.detector.packed import Run, packed

Precision: TypeAlias = Literal["auto", "fp32", "bf16", "fp16"]

MAX_SHAPES = 8
"""Input shapes that the net stays prepared for. A stream has one; strangers may not fill memory."""
SEEN_BEFORE_PREPARING = 3
"""Preparing a shape takes 0.1 s, as long as five frames: only what comes again is worth it."""

MEASURED_RUNS = 5
MEASURING_LIMIT_S = 2.0
"""On a machine that is busy with other things the choice of the precision may not take longer."""


class Prepared:
    """The net as it runs best for each shape of input.

    Args:
        plain: runs any shape.
        prepare: makes what runs one shape faster, from an example of it; None: there is no such.
    """

    def __init__(self, plain: Run, prepare: Callable[[Tensor], Run | None]) -> None:
        self._plain = plain
        self._prepare = prepare
        self._runs: OrderedDict[tuple[int, ...], Run | None] = OrderedDict()
        self._seen: dict[tuple[int, ...], int] = {}

    def run_for(self, images: Tensor, *, at_once: bool = False) -> Run:
        """What to run for images of this shape; prepared when it has come often enough."""
        shape = tuple(images.shape)
        if shape in self._runs:
            self._runs.move_to_end(shape)
            return self._runs[shape] or self._plain
        seen = self._seen[shape] = self._seen.get(shape, 0) + 1
        if seen < SEEN_BEFORE_PREPARING and not at_once:
            if len(self._seen) > 16 * MAX_SHAPES:
                self._seen.clear()
            return self._plain
        del self._seen[shape]
        run = self._runs[shape] = self._prepare(images)
        if len(self._runs) > MAX_SHAPES:
            self._runs.popitem(last=False)
        return run or self._plain


class CpuEngine:
    """The fused net in channels_last, its convolutions packed for the shapes that come often."""

    def __init__(self, net: TargetNet, dtype: torch.dtype) -> None:
        fused = net.fused()
        if dtype == torch.bfloat16:
            fused = fused.bfloat16_body()
        # torch's stub lacks the overload with a memory format alone
        fused = fused.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.dtype = dtype
        self._prepared = Prepared(fused, lambda images: packed(fused, images))

    def infer(self, pictures: NDArray[np.uint8]) -> Outputs:
        """Logits (B, N, C) and distances (B, N, C, 4) of pictures (B, H, W, 3)."""
        return self._infer(pictures, at_once=False)

    def warm_up(self, pictures: NDArray[np.uint8]) -> None:
        """Prepare for pictures of this shape."""
        self._infer(pictures, at_once=True)

    def _infer(self, pictures: NDArray[np.uint8], at_once: bool) -> Outputs:
        with torch.inference_mode():
            images = as_images(pictures).to(self.dtype).div_(255)
            logits, distances = self._prepared.run_for(images, at_once=at_once)(images)
            return logits.numpy(), distances.numpy()


def as_images(pictures: NDArray[np.uint8]) -> Tensor:
    """Pictures (B, H, W, 3) seen as (B, 3, H, W): channels_last as they lie in memory, no copy."""
    return torch.from_numpy(np.ascontiguousarray(pictures)).permute(0, 3, 1, 2)


def faster(engines: Mapping[str, CpuEngine], size: tuple[int, int]) -> str:
    """The name of the engine that is faster on blank pictures of ``size`` (H, W); all are warm."""
    blank = np.zeros((1, *size, 3), np.uint8)
    for engine in engines.values():
        engine.warm_up(blank)
    best = dict.fromkeys(engines, float("inf"))
    limit = time.perf_counter() + MEASURING_LIMIT_S
    for run in range(1 + MEASURED_RUNS):
        if run > 1 and time.perf_counter() > limit:
            break
        for name, engine in engines.items():  # in turns: a busy moment hits both
            start = time.perf_counter()
            engine.infer(blank)
            if run:  # the first fills the caches
                best[name] = min(best[name], time.perf_counter() - start)
    return min(best, key=best.__getitem__)
