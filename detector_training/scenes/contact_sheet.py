"""Many labelled pictures on one sheet, to judge a data set by eye."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

COLUMNS = 8
ROWS = 6
TILE = (240, 180)
COLOURS_BGR = {"T_good": (80, 220, 80), "T_better": (255, 160, 40), "T_best": (60, 80, 255)}


def contact_sheet(folder: Path, labels: Sequence[dict[str, Any]]) -> NDArray[np.uint8]:
    """The first pictures of a data set with their boxes, each beside its depth if it has, BGR."""
    tiles = []
    for label in labels[: COLUMNS * ROWS]:
        image = np.asarray(cv2.imread(str(folder / label["image"])))
        scale = (TILE[0] / image.shape[1], TILE[1] / image.shape[0])
        tile = cv2.resize(image, TILE, interpolation=cv2.INTER_AREA)
        for box in label["boxes"]:
            x0, y0, x1, y1 = (
                round((v + 0.5) * scale[i % 2] - 0.5) for i, v in enumerate(box["xyxy"])
            )
            cv2.rectangle(tile, (x0, y0), (x1, y1), COLOURS_BGR[box["level"]], 1, cv2.LINE_AA)
        tiles.append(tile)
        if label.get("depth"):
            tiles.append(_depth_tile(folder / label["depth"]))
    tiles = tiles[: COLUMNS * ROWS]
    columns = min(COLUMNS, len(tiles))
    while len(tiles) % columns:
        tiles.append(np.zeros_like(tiles[0]))
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    return np.asarray(np.vstack(rows), dtype=np.uint8)


def _depth_tile(path: Path) -> NDArray[np.uint8]:
    """Near is bright, far is dark, and what has no depth is red."""
    depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    units = np.asarray(cv2.resize(np.asarray(depth), TILE, interpolation=cv2.INTER_NEAREST))
    known = units > 0
    nearness = np.zeros(units.shape)
    if known.any():
        nearness[known] = np.quantile(units[known], 0.02) / units[known]
    gray = (255 * np.clip(nearness, 0, 1)).astype(np.uint8)
    tile = np.repeat(gray[..., None], 3, axis=-1)
    tile[~known] = (40, 40, 160)
    return np.asarray(tile, dtype=np.uint8)
