"""Pictures to look at: what the net is taught, and what it sees in the end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.sample import CORNER_PX
from detector_training.datasets.sheet import COLOURS_BGR
from detector_training.evaluation.run import Find, confident
from detector_training.training.batches import BatchSource
from target_pose.target import Level

MOST = 24
COLUMNS = 6
TILE = (256, 192)
IGNORED_BGR = (150, 150, 150)
TRUE_BGR = (0, 220, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


class Drawn(NamedTuple):
    """A box to draw."""

    xyxy: Sequence[float]
    """[px], from the centre of the first pixel."""
    bgr: tuple[int, int, int]
    thick: int = 1
    text: str = ""


def draw_crops(source: BatchSource, most: int = MOST) -> NDArray[np.uint8]:
    """The first crops of a run, BGR, with what they teach; gray boxes are ignored.

    Raises:
        DatasetError: a picture cannot be read.
    """
    tiles: list[NDArray[np.uint8]] = []
    step = 0
    while len(tiles) < most:
        batch = source.make(step)
        for image, truth in zip(batch.images, batch.truths, strict=True):
            boxes = [
                Drawn(box, IGNORED_BGR if ignore else COLOURS_BGR[list(Level)[level]])
                for box, level, ignore in zip(*(t.tolist() for t in truth), strict=True)
            ]
            tiles.append(_tile(image.permute(1, 2, 0).numpy(), boxes))
        step += 1
    return _sheet(tiles[:most])


def draw_finds(finds: Sequence[Find], most: int = MOST) -> NDArray[np.uint8]:
    """Some validation pictures, BGR: true boxes yellow and thick, found ones in their colour.

    Raises:
        DatasetError: a picture cannot be read any more.
    """
    count = min(most, len(finds))
    tiles = []
    for k in range(count):
        find = finds[k * len(finds) // count]
        boxes = [Drawn(xyxy, TRUE_BGR, 2) for xyxy in find.sample.boxes.tolist()]
        for level, found in confident(find.detections).boxes.items():
            boxes += [
                Drawn((b.x0, b.y0, b.x1, b.y1), COLOURS_BGR[level], 1, f"{b.score:.2f}")
                for b in found
            ]
        tiles.append(_tile(find.sample.read(), boxes))
    return _sheet(tiles)


def _tile(rgb: NDArray[np.uint8], boxes: Sequence[Drawn]) -> NDArray[np.uint8]:
    """A picture (H, W, 3) fitted into a tile, its boxes drawn."""
    scale = min(TILE[0] / rgb.shape[1], TILE[1] / rgb.shape[0])
    width, height = (max(round(side * scale), 1) for side in rgb.shape[1::-1])
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    tile = np.zeros((TILE[1], TILE[0], 3), np.uint8)
    view = tile[:height, :width]
    view[:] = cv2.resize(np.ascontiguousarray(rgb[..., ::-1]), (width, height), interpolation=how)
    for box in boxes:
        ends = [round(float(np.clip((v + CORNER_PX) * scale, -9e3, 9e3))) for v in box.xyxy]
        cv2.rectangle(view, ends[:2], ends[2:], box.bgr, box.thick, cv2.LINE_AA)
        if box.text:
            where = (max(ends[0], 0), min(max(ends[1] - 2, 9), height))
            cv2.putText(view, box.text, where, _FONT, 0.3, box.bgr, 1, cv2.LINE_AA)
    return tile


def _sheet(tiles: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    columns = min(COLUMNS, len(tiles))
    padded = [*tiles, *[np.zeros_like(tiles[0])] * (-len(tiles) % columns)]
    rows = [np.hstack(padded[i : i + columns]) for i in range(0, len(padded), columns)]
    return np.asarray(np.vstack(rows), np.uint8)
