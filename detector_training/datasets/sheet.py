"""The pictures with findings on one sheet: wrong boxes drawn thick, and what is wrong with them."""

from __future__ import annotations

import textwrap
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.check import Finding
from detector_training.datasets.output import write_file
from detector_training.datasets.sample import CORNER_PX, Sample
from detector_training.errors import DatasetError
from target_pose.target import Level

MOST = 24
COLUMNS = 4
TILE = (400, 300)
CAPTION_PX = 64
LINE = 78
"""Characters of a caption's line."""
AROUND = 2.5
"""What is shown around boxes at fault, in their own size; far targets are small."""
LEAST_PX = 80
COLOURS_BGR = {
    Level.GOOD: (80, 220, 80),
    Level.BETTER: (255, 160, 40),
    Level.BEST: (60, 80, 255),
}
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_sheet(samples: Sequence[Sample], findings: Sequence[Finding]) -> NDArray[np.uint8] | None:
    """The pictures with most findings first, BGR; None where no picture has any."""
    of_picture: defaultdict[int, list[Finding]] = defaultdict(list)
    for finding in findings:
        if finding.sample is not None:
            of_picture[finding.sample].append(finding)
    worst = sorted(of_picture.items(), key=lambda kv: (-sum(f.wrong for f in kv[1]), kv[0]))
    tiles = [_tile(samples[i], mine) for i, mine in worst[:MOST]]
    if not tiles:
        return None
    columns = min(COLUMNS, len(tiles))
    while len(tiles) % columns:
        tiles.append(np.zeros_like(tiles[0]))
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    return np.asarray(np.vstack(rows), np.uint8)


def write_png(path: Path, bgr: NDArray[np.uint8]) -> None:
    """Write a picture as PNG.

    Raises:
        DatasetError: it cannot be written.
    """
    _, data = cv2.imencode(".png", bgr)
    write_file(path, data.tobytes())


def _tile(sample: Sample, findings: Sequence[Finding]) -> NDArray[np.uint8]:
    try:
        image = np.ascontiguousarray(sample.read()[..., ::-1])
    except DatasetError:
        image = np.full((sample.height, sample.width, 3), 40, np.uint8)
    wrong = {i for f in findings for i in f.boxes}
    x0, y0, x1, y1 = _window(sample, sorted(wrong))
    image = image[y0:y1, x0:x1]
    scale = min(TILE[0] / image.shape[1], TILE[1] / image.shape[0])
    width, height = (max(round(side * scale), 1) for side in image.shape[1::-1])
    tile = np.zeros((TILE[1] + CAPTION_PX, TILE[0], 3), np.uint8)
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    tile[:height, :width] = cv2.resize(image, (width, height), interpolation=how)
    view = tile[:height, :width]
    for i, box in enumerate(sample.labels):
        shifted = np.subtract(box.xyxy, (x0, y0, x0, y0))
        ends = [round(float(np.clip((v + CORNER_PX) * scale, -1e4, 1e4))) for v in shifted]
        colour = COLOURS_BGR[box.level]
        cv2.rectangle(view, ends[:2], ends[2:], colour, 3 if i in wrong else 1, cv2.LINE_AA)
    text = f"{sample.image.name}: " + "; ".join(f.text for f in findings)
    for row, line in enumerate(textwrap.wrap(text, LINE)[:4]):
        place = (4, TILE[1] + 14 + 15 * row)
        cv2.putText(tile, line, place, _FONT, 0.36, (240, 240, 240), 1, cv2.LINE_AA)
    return tile


def _window(sample: Sample, wrong: Sequence[int]) -> tuple[int, int, int, int]:
    """The part of a picture to show: around the boxes at fault that are in it, else all of it."""
    whole = (0, 0, sample.width, sample.height)
    if not wrong:
        return whole
    boxes = sample.boxes[list(wrong)]
    low, high = boxes[:, :2].min(0), boxes[:, 2:].max(0)
    half = max(float((high - low).max()) * AROUND, LEAST_PX) / 2
    x, y = (float(v) for v in (low + high) / 2)
    wide = half * TILE[0] / TILE[1]
    x0, x1 = max(round(x - wide), 0), min(round(x + wide), whole[2])
    y0, y1 = max(round(y - half), 0), min(round(y + half), whole[3])
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else whole
