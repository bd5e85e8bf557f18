"""What a net's outputs mean: from raw arrays to the boxes of each level that are worth a look.

Three layouts are read, all of RGB in [0, 1] as (B, 3, H, W):

- ``cells``: our own. ``logits`` (B, N, C) and ``distances`` (B, N, C, 4) of N cells (``grid``).
- ``yolo``: one output (B, 4 + K, N), as YOLOv8 and v11 export it: centre x, centre y, width and
  height in pixels of the input, then K scores after the sigmoid; no objectness.
- ``end_to_end``: one output (B, N, 6), as models with suppression inside export it: x0, y0, x1, y1
  in pixels of the input, score, index of the class.

Pose exports of the last two kinds have key points beside each box: ``yolo`` (B, 4 + K + 3 P, N),
``end_to_end`` (B, N, 6 + 3 P), for each of P points x, y and a confidence after the sigmoid, or
without the confidence 2 P. They are the target's labelled points in its order.

In all but our own a coordinate counts from the left edge of the first pixel, ours from its centre.
Only what passes the threshold is turned into scores and boxes: of 6300 cells a few dozen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from edge_service.detector.grid import cell_centers
from target_pose.target import Level

Outputs: TypeAlias = tuple[NDArray[np.float32], ...]
"""The arrays that a net answers with, the batch along the first axis."""

MAX_CELLS_PER_LEVEL = 300
"""The best of a class that go into suppression: bounds its time in any picture."""


class Found(NamedTuple):
    """The boxes of one level in one picture, before suppression."""

    boxes: NDArray[np.float32]  # (K, 4)
    """x0, y0, x1, y1 [px of the input], from pixel centres."""
    scores: NDArray[np.float32]  # (K,)
    points: NDArray[np.float32] | None = None  # (K, P, 3)
    """x, y [px of the input], from pixel centres, and confidence of each box's key points."""


@dataclass(frozen=True, slots=True)
class KeyPoints:
    """Where a foreign model's answer about a box has its key points."""

    first: int
    """Place of the first number of the first point."""
    count: int
    numbers: int
    """Of each point: 3, or 2 without a confidence."""

    def read(self, answers: NDArray[np.float32]) -> NDArray[np.float32]:
        """Points (K, P, 3) of answers (K, M), one a box."""
        end = self.first + self.count * self.numbers
        given = answers[:, self.first : end].reshape(-1, self.count, self.numbers)
        points = np.ones((*given.shape[:2], 3), np.float32)
        points[..., : self.numbers] = given
        points[..., :2] -= np.float32(0.5)
        return points


class Layout(Protocol):
    """How one family of nets is read."""

    @property
    def name(self) -> str:
        """For people."""
        ...

    @property
    def levels(self) -> tuple[Level, ...]:
        """Levels that the net knows."""
        ...

    @property
    def points(self) -> int:
        """Key points that it gives with each box."""
        ...

    def read(
        self, outputs: Outputs, row: int, size: tuple[int, int], threshold: float
    ) -> dict[Level, Found]:
        """What picture ``row`` of a batch shows, per level.

        Args:
            outputs: of the whole batch.
            row: in the batch.
            size: (H, W) of the input [px].
            threshold: scores at or below are left out.
        """
        ...


@dataclass(frozen=True, slots=True)
class CellLayout:
    """Our own net: every cell has a score and four distances for each level."""

    levels: tuple[Level, ...]
    name: str = "cells"
    points: int = 0

    def read(
        self, outputs: Outputs, row: int, size: tuple[int, int], threshold: float
    ) -> dict[Level, Found]:
        """See ``Layout.read``."""
        logits, distances = outputs[0][row], outputs[1][row]
        # the sigmoid is monotonic: the threshold goes to the logits and not they to it
        limit = math.log(threshold / (1 - threshold))
        found = {}
        for c, level in enumerate(self.levels):
            at = _best(logits[:, c], limit)
            scores = 1 / (1 + np.exp(-logits[at, c], dtype=np.float32))
            far, center = distances[at, c], cell_centers(*size)[at]
            boxes = np.concatenate((center - far[:, :2], center + far[:, 2:]), 1)
            found[level] = Found(boxes, scores)
        return found


@dataclass(frozen=True, slots=True)
class YoloLayout:
    """A foreign net of the YOLOv8 and v11 kind; its classes by their place in the output."""

    columns: dict[Level, int]
    """Which class each level is."""
    name: str = "yolo"
    key_points: KeyPoints | None = None

    @property
    def levels(self) -> tuple[Level, ...]:
        """Levels that the net knows."""
        return tuple(self.columns)

    @property
    def points(self) -> int:
        """Key points that it gives with each box."""
        return 0 if self.key_points is None else self.key_points.count

    def read(
        self, outputs: Outputs, row: int, size: tuple[int, int], threshold: float
    ) -> dict[Level, Found]:
        """See ``Layout.read``."""
        whole = outputs[0][row]
        found = {}
        for level, column in self.columns.items():
            scores = whole[4 + column]
            at = _best(scores, threshold)
            center, half = whole[:2, at].T, whole[2:4, at].T / 2
            boxes = np.concatenate((center - half, center + half), 1) - np.float32(0.5)
            points = None if self.key_points is None else self.key_points.read(whole[:, at].T)
            found[level] = Found(boxes, scores[at], points)
        return found


@dataclass(frozen=True, slots=True)
class EndToEndLayout:
    """A foreign net that suppresses by itself and lists what stays."""

    columns: dict[Level, int]
    """Which class each level is."""
    name: str = "end_to_end"
    key_points: KeyPoints | None = None

    @property
    def levels(self) -> tuple[Level, ...]:
        """Levels that the net knows."""
        return tuple(self.columns)

    @property
    def points(self) -> int:
        """Key points that it gives with each box."""
        return 0 if self.key_points is None else self.key_points.count

    def read(
        self, outputs: Outputs, row: int, size: tuple[int, int], threshold: float
    ) -> dict[Level, Found]:
        """See ``Layout.read``."""
        whole = outputs[0][row]
        found = {}
        for level, column in self.columns.items():
            scores = np.where(np.round(whole[:, 5]) == column, whole[:, 4], np.float32(0))
            at = _best(scores, threshold)
            points = None if self.key_points is None else self.key_points.read(whole[at])
            found[level] = Found(whole[at, :4] - np.float32(0.5), scores[at], points)
        return found


def _best(values: NDArray[np.float32], limit: float) -> NDArray[np.intp]:
    """Places of the highest values over a limit, as many as go into suppression."""
    at = np.flatnonzero(values > limit)
    if len(at) > MAX_CELLS_PER_LEVEL:
        at = at[np.argsort(-values[at], kind="stable")[:MAX_CELLS_PER_LEVEL]]
    return at
