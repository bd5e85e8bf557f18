"""The detector at work: one picture in, boxes per level out, as fast as this CPU allows."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import torch
from numpy.typing import NDArray

from edge_service.detector.boxes import cell_centers, decode
from edge_service.detector.letterbox import (
    WORKING_SIDE_PX,
    Letterbox,
    check_image,
    letterbox,
)
from edge_service.detector.net import TargetNet
from edge_service.detector.nms import suppress
from edge_service.detector.threads import available_cpus
from edge_service.detector.weights import DEFAULT_WEIGHTS, load_weights
from edge_service.errors import EdgeError
from target_pose.candidate import Box, Detections
from target_pose.target import Level

Precision: TypeAlias = Literal["auto", "fp32", "bf16"]

SCORE_THRESHOLD = 0.25
NMS_IOU = 0.6
MAX_BOXES_PER_LEVEL = 20
MAX_CELLS_PER_LEVEL = 300
"""The best cells of a class that go into suppression: bounds its time in any picture."""

WARM_UP_SIZE = (480, 640)
WARM_UP_RUNS = 5
WARM_UP_LIMIT_S = 2.0
"""On a machine that is busy with other things the choice of the precision may not take longer."""


class TorchDetector:
    """Finds the three levels of the target in a colour picture.

    Not thread-safe by intent: one instance belongs to one worker thread.

    Args:
        weights: A weights file; None: the packaged one.
        threads: Threads of torch in this process; None: what affinity and CPU quota leave.
        precision: ``auto`` measures bf16 against fp32 at start and takes the faster.
        score_threshold: Boxes below are dropped.

    Raises:
        WeightsError: the file cannot be used.
        EdgeError: an argument is out of bounds.
    """

    def __init__(
        self,
        weights: Path | None = None,
        *,
        threads: int | None = None,
        precision: Precision = "auto",
        score_threshold: float = SCORE_THRESHOLD,
    ) -> None:
        if precision not in get_args(Precision):
            raise EdgeError(f"precision {precision!r} is not one of {get_args(Precision)}")
        if threads is not None and not 1 <= threads <= 256:
            raise EdgeError(f"threads = {threads} is not in [1, 256]")
        if not 0 < score_threshold < 1:
            raise EdgeError(f"score threshold = {score_threshold} is not in (0, 1)")
        self._path = weights or DEFAULT_WEIGHTS
        net, self._info = load_weights(self._path)
        self._parameters = sum(p.numel() for p in net.parameters())
        self._threads = threads or available_cpus()
        torch.set_num_threads(self._threads)
        self._levels = tuple(Level(name) for name in self._info.config.classes)
        self._score_threshold = score_threshold
        self._centers: dict[tuple[int, int], torch.Tensor] = {}
        self._net, self._dtype = self._fastest(net, precision)

    @property
    def model_hash(self) -> str:
        """SHA-256 of the weights file, in hex."""
        return self._info.sha256

    def describe(self) -> dict[str, Any]:
        """What runs here, for people and for ``/v1/model``."""
        return {
            "name": self._path.stem,
            "target": self._info.target,
            "levels": [level.value for level in self._levels],
            "model_hash": self.model_hash,
            "weights_version": self._info.version,
            "parameters": self._parameters,
            "width": self._info.config.width,
            "backend": f"torch {torch.__version__}",
            "precision": "bf16" if self._dtype == torch.bfloat16 else "fp32",
            "threads": self._threads,
            "working_side_px": WORKING_SIDE_PX,
            "score_threshold": self._score_threshold,
            "nms_iou": NMS_IOU,
        }

    def detect(self, color_rgb: NDArray[np.uint8]) -> Detections:
        """All boxes of one picture, in its pixels; a cut target's boxes reach over the border.

        Args:
            color_rgb: (H, W, 3), sides of 16 to 4096 px.

        Raises:
            ImageError: it is no such picture.
        """
        (found,) = self.detect_batch([color_rgb])
        return found

    def detect_batch(self, colors_rgb: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        """All boxes of each of several pictures; the net runs once for all of one input size.

        Args:
            colors_rgb: of each (H, W, 3), sides of 16 to 4096 px.

        Raises:
            ImageError: one of them is no such picture; the net has seen none then.
        """
        for color_rgb in colors_rgb:
            check_image(color_rgb)
        inputs = [letterbox(color_rgb) for color_rgb in colors_rgb]
        same_size: dict[tuple[int, ...], list[int]] = {}
        for k, (padded, _) in enumerate(inputs):
            same_size.setdefault(padded.shape, []).append(k)
        found: dict[int, Detections] = {}
        for places in same_size.values():
            whole = [inputs[k][0] for k in places]
            padded = whole[0][None] if len(whole) == 1 else np.stack(whole)  # one: no copy
            boxes, scores = self._infer(self._net, self._dtype, padded)
            for row, k in enumerate(places):
                found[k] = self._boxes(boxes[row], scores[row], inputs[k][1])
        return [found[k] for k in range(len(inputs))]

    def _boxes(
        self, boxes: NDArray[np.float32], scores: NDArray[np.float32], back: Letterbox
    ) -> Detections:
        """The boxes of one picture from (N, C, 4) and (N, C) of all cells."""
        found = {}
        for c, level in enumerate(self._levels):
            above = np.flatnonzero(scores[:, c] > self._score_threshold)
            if len(above) > MAX_CELLS_PER_LEVEL:
                above = above[np.argsort(-scores[above, c])[:MAX_CELLS_PER_LEVEL]]
            candidates, confidence = back.to_picture(boxes[above, c]), scores[above, c]
            kept = suppress(candidates, confidence, NMS_IOU, MAX_BOXES_PER_LEVEL)
            rows = zip(candidates[kept].tolist(), confidence[kept].tolist(), strict=True)
            found[level] = tuple(Box(x0, y0, x1, y1, s) for (x0, y0, x1, y1), s in rows)
        return Detections(found)

    def _infer(
        self, net: TargetNet, dtype: torch.dtype, padded: NDArray[np.uint8]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Boxes (B, N, C, 4) [px of the input] and scores (B, N, C) of inputs (B, H, W, 3)."""
        height, width = padded.shape[1:3]
        with torch.inference_mode():
            # (B, H, W, 3) seen as (B, 3, H, W) is channels_last as it lies in memory
            images = torch.from_numpy(np.ascontiguousarray(padded)).permute(0, 3, 1, 2)
            prediction = net(images.to(dtype) / 255)
            centers = self._centers.get((height, width))
            if centers is None:
                if (
                    len(self._centers) > 16
                ):  # a stream has one size; strangers shall not fill memory
                    self._centers.clear()
                centers = self._centers[height, width] = cell_centers(height, width)[0]
            boxes = decode(prediction.distances, centers)
            return boxes.numpy(), prediction.logits.sigmoid().numpy()

    def _fastest(self, net: TargetNet, precision: Precision) -> tuple[TargetNet, torch.dtype]:
        """The net warmed up, in the precision asked for or in the faster one of this CPU."""
        ready: list[tuple[TargetNet, torch.dtype]] = []
        for name, dtype in (("bf16", torch.bfloat16), ("fp32", torch.float32)):
            if precision in ("auto", name):
                fused = net.fused()
                if dtype == torch.bfloat16:
                    fused = fused.bfloat16_body()
                # torch's stub lacks the overload with a memory format alone
                fused = fused.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
                ready.append((fused, dtype))
        blank = np.zeros((1, *WARM_UP_SIZE, 3), np.uint8)
        best = [float("inf")] * len(ready)
        limit = time.perf_counter() + WARM_UP_LIMIT_S
        for run in range(1 + WARM_UP_RUNS):
            if run > 1 and time.perf_counter() > limit:
                break
            for k, (fused, dtype) in enumerate(ready):  # in turns: a busy moment hits both
                start = time.perf_counter()
                self._infer(fused, dtype, blank)
                if run:  # the first fills the caches
                    best[k] = min(best[k], time.perf_counter() - start)
        return ready[best.index(min(best))]
