"""The detector around any engine: pictures in, boxes per level out, in the pictures' own pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from edge_service.detector.layouts import Layout, Outputs
from edge_service.detector.letterbox import (
    WORKING_SIDE_PX,
    Letterbox,
    check_image,
    letterbox,
    letterbox_into,
)
from edge_service.detector.nms import suppress
from edge_service.errors import EdgeError
from target_pose.candidate import Box, Detections
from target_pose.points import PointPx
from target_pose.target import Level

SCORE_THRESHOLD = 0.25
NMS_IOU = 0.6
MAX_BOXES_PER_LEVEL = 20
MAX_THREADS = 256

WARM_UP_SIZE = (480, 640)
"""(H, W) of the pictures that a camera sends as a rule; an engine is warm for them at start."""


class Engine(Protocol):
    """Runs a net. What its answer means is the layout's business."""

    def infer(self, pictures: NDArray[np.uint8]) -> Outputs:
        """The net's raw outputs for pictures (B, H, W, 3), RGB; valid until the next call."""
        ...


@dataclass(frozen=True, slots=True)
class Model:
    """What is known of a model, whatever runs it."""

    name: str
    target: str | None
    """Target that it was made for; None: a foreign file does not say."""
    sha256: str
    """Of the file that was asked for, in hex."""
    layout: Layout
    size: tuple[int, int] | None
    """(H, W) of the input [px] if it takes one size only; None: any multiple of 32."""
    facts: dict[str, Any]
    """More of it, for people."""


class EngineDetector:
    """Finds the levels of the target in colour pictures.

    Not thread-safe by intent: one instance belongs to one worker thread.

    Args:
        engine: runs the net.
        model: what the net is.
        running: how the engine runs it, for people: engine, backend, precision, threads.
        score_threshold: boxes at or below are dropped.

    Raises:
        EdgeError: the threshold is out of bounds.
    """

    def __init__(
        self,
        engine: Engine,
        model: Model,
        running: dict[str, Any],
        score_threshold: float = SCORE_THRESHOLD,
    ) -> None:
        check_threshold(score_threshold)
        self._engine = engine
        self._model = model
        self._running = running
        self._score_threshold = score_threshold

    @property
    def model_hash(self) -> str:
        """SHA-256 of the weights file, in hex."""
        return self._model.sha256

    def describe(self) -> dict[str, Any]:
        """What runs here, for people and for ``/v1/model``."""
        model = self._model
        size = model.size
        return {
            "name": model.name,
            "target": model.target,
            "levels": [level.value for level in model.layout.levels],
            "points": model.layout.points,
            "model_hash": model.sha256,
            "layout": model.layout.name,
            **model.facts,
            **self._running,
            "working_side_px": WORKING_SIDE_PX if size is None else max(size),
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
        inputs = [self._letterbox(color_rgb) for color_rgb in colors_rgb]
        same_size: dict[tuple[int, ...], list[int]] = {}
        for k, (padded, _) in enumerate(inputs):
            same_size.setdefault(padded.shape, []).append(k)
        found: dict[int, Detections] = {}
        for shape, places in same_size.items():
            whole = [inputs[k][0] for k in places]
            padded = whole[0][None] if len(whole) == 1 else np.stack(whole)  # one: no copy
            outputs = self._engine.infer(padded)
            for row, k in enumerate(places):
                found[k] = self._boxes(outputs, row, (shape[0], shape[1]), inputs[k][1])
        return [found[k] for k in range(len(inputs))]

    def _letterbox(self, color_rgb: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Letterbox]:
        size = self._model.size
        return letterbox(color_rgb) if size is None else letterbox_into(color_rgb, size)

    def _boxes(
        self, outputs: Outputs, row: int, size: tuple[int, int], back: Letterbox
    ) -> Detections:
        """The boxes of one picture of a batch."""
        read = self._model.layout.read(outputs, row, size, self._score_threshold)
        found: dict[Level, tuple[Box, ...]] = {}
        for level, (raw, scores, raw_points) in read.items():
            boxes = back.to_picture(raw)
            kept = suppress(boxes, scores, NMS_IOU, MAX_BOXES_PER_LEVEL)
            points = _points(None if raw_points is None else raw_points[kept], back, len(kept))
            rows = zip(boxes[kept].tolist(), scores[kept].tolist(), points, strict=True)
            found[level] = tuple(Box(x0, y0, x1, y1, s, p) for (x0, y0, x1, y1), s, p in rows)
        return Detections(found)


def _points(
    raw: NDArray[np.float32] | None, back: Letterbox, boxes: int
) -> list[tuple[PointPx, ...]]:
    """The key points of each box, in the picture's pixels; none where the net has none."""
    if raw is None:
        return [()] * boxes
    places = back.points_to_picture(raw[..., :2])
    whole = np.concatenate([places, raw[..., 2:]], axis=-1).tolist()
    return [tuple(PointPx(*point) for point in row) for row in whole]


def check_threshold(score_threshold: float) -> None:
    """Refuse a threshold that keeps all or nothing.

    Raises:
        EdgeError: states the value.
    """
    if not 0 < score_threshold < 1:
        raise EdgeError(f"score threshold = {score_threshold} is not in (0, 1)")


def check_threads(threads: int | None) -> None:
    """Refuse a number of threads that no machine has.

    Raises:
        EdgeError: states the value.
    """
    if threads is not None and not 1 <= threads <= MAX_THREADS:
        raise EdgeError(f"threads = {threads} is not in [1, {MAX_THREADS}]")
