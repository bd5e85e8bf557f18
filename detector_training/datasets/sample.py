"""A labelled data set on disk: ``images/*.jpg`` and ``labels.jsonl``, one JSON object per picture.

Fields: ``image width height kind conditions boxes``, each box with ``level xyxy visible``; a true
box may reach over the picture's border, and the visible share of each is in [0, 1].
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.errors import DatasetError
from target_pose.target import Level

CLASSES = tuple(level.value for level in Level)
"""The net's classes, in the order of its outputs."""

MAX_LABELS_BYTES = 256 << 20
MAX_PICTURES = 1_000_000
MAX_IMAGE_BYTES = 64 << 20
MAX_COORDINATE_PX = 1e5
MAX_BOXES = 256
MAX_DISTANCE_M = 1e4


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One picture and its truth; M boxes."""

    image: Path
    width: int
    height: int
    kind: str
    """``scene`` or ``negative``."""
    conditions: tuple[str, ...]
    boxes: NDArray[np.float32]  # (M, 4)
    """x0, y0, x1, y1 [px]; pixel (0, 0) is the centre of the first pixel."""
    classes: NDArray[np.int64]  # (M,)
    visible: NDArray[np.float32]  # (M,)
    distance_m: float | None = None
    """From the camera to the target's centre; None where the data set does not say."""

    def read(self) -> NDArray[np.uint8]:
        """The picture, RGB (H, W, 3).

        Raises:
            DatasetError: it cannot be read or has another size than its label says.
        """
        return decode_image(self, read_bytes(self.image))


def read_bytes(path: Path) -> bytes:
    """The bytes of a picture file.

    Raises:
        DatasetError: it cannot be read or is larger than ``MAX_IMAGE_BYTES``.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_IMAGE_BYTES + 1)
    except OSError as error:
        raise DatasetError(f"picture {path}: {error.strerror}") from None
    if len(data) > MAX_IMAGE_BYTES:
        raise DatasetError(f"picture {path} is over {MAX_IMAGE_BYTES} bytes")
    return data


def decode_image(sample: Sample, data: bytes) -> NDArray[np.uint8]:
    """The picture in ``data``, RGB (H, W, 3), checked against its label.

    Raises:
        DatasetError: the bytes are no picture or one of another size.
    """
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if bgr is None:
        raise DatasetError(f"picture {sample.image} cannot be decoded")
    if bgr.shape != (sample.height, sample.width, 3):
        raise DatasetError(
            f"picture {sample.image} is {bgr.shape[1]}x{bgr.shape[0]}, "
            f"its label says {sample.width}x{sample.height}"
        )
    rgb: NDArray[np.uint8] = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
    return rgb


def load_dataset(folder: Path) -> tuple[Sample, ...]:
    """All samples of a data set, in the order of its labels.

    Raises:
        DatasetError: names the file, the line and the field at fault.
    """
    path = folder / "labels.jsonl"
    samples: list[Sample] = []
    try:
        if path.stat().st_size > MAX_LABELS_BYTES:
            raise DatasetError(f"{path} is over {MAX_LABELS_BYTES} bytes")
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                if number > MAX_PICTURES:
                    raise DatasetError(f"{path} has over {MAX_PICTURES} lines")
                try:
                    samples.append(_sample(folder, json.loads(line)))
                except (
                    DatasetError,
                    ValueError,
                    TypeError,
                    OverflowError,
                    RecursionError,
                ) as error:
                    raise DatasetError(f"{path} line {number}: {error}") from None
                except KeyError as error:
                    raise DatasetError(f"{path} line {number}: lacks {error.args[0]}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"no data set in {folder}: {error}") from None
    if not samples:
        raise DatasetError(f"{path} has no pictures")
    return tuple(samples)


def _sample(folder: Path, raw: Any) -> Sample:
    if not isinstance(raw, dict):
        raise DatasetError("a line must be a JSON object")
    name = PurePosixPath(str(raw["image"]))
    if not name.parts or name.is_absolute() or ".." in name.parts:
        raise DatasetError(f"image {str(name)!r} leaves the data set's folder")
    path = folder / name
    if name.parts[0] != "images":  # the label may name the file alone
        path = folder / "images" / name
    width, height = int(raw["width"]), int(raw["height"])
    if not (0 < width <= 8192 and 0 < height <= 8192):
        raise DatasetError(f"a picture of {width}x{height} px")
    kind = raw["kind"]
    if kind not in ("scene", "negative"):
        raise DatasetError(f"kind {kind!r} is neither scene nor negative")
    entries = raw["boxes"]
    if not isinstance(entries, list) or len(entries) > MAX_BOXES:
        raise DatasetError(f"boxes must be a list of at most {MAX_BOXES}")
    boxes = [_box(entry) for entry in entries]
    return Sample(
        path,
        width,
        height,
        kind,
        tuple(str(c) for c in raw["conditions"]),
        np.array([b[0] for b in boxes], np.float32).reshape(-1, 4),
        np.array([b[1] for b in boxes], np.int64),
        np.array([b[2] for b in boxes], np.float32),
        _distance(raw.get("distance_m")),
    )


def _distance(raw: Any) -> float | None:
    if raw is None:
        return None
    distance = float(raw)
    if not 0 < distance < MAX_DISTANCE_M:
        raise DatasetError(f"distance_m = {distance} is not in (0, {MAX_DISTANCE_M:g})")
    return distance


def _box(raw: Any) -> tuple[list[float], int, float]:
    level = raw["level"]
    if level not in CLASSES:
        raise DatasetError(f"level {level!r} is not one of {', '.join(CLASSES)}")
    xyxy = [float(x) for x in raw["xyxy"]]
    if len(xyxy) != 4 or not all(math.isfinite(x) and abs(x) < MAX_COORDINATE_PX for x in xyxy):
        raise DatasetError(f"xyxy must be four finite pixels, not {raw['xyxy']}")
    if not (xyxy[0] < xyxy[2] and xyxy[1] < xyxy[3]):
        raise DatasetError(f"xyxy must be x0 < x1, y0 < y1, not {xyxy}")
    visible = float(raw["visible"])
    if not 0 <= visible <= 1:
        raise DatasetError(f"visible = {visible} is not in [0, 1]")
    return xyxy, CLASSES.index(level), visible
