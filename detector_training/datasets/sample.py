"""A labelled picture, and its pixels.

Boxes count from the *centre* of the first pixel: a shape that fills a picture of W x H pixels has
the box (-0.5, -0.5, W - 0.5, H - 0.5). labelme, YOLO and COCO count from its corner, half a pixel
off; their readers and writers convert. A true box may reach over the picture's border.

A picture is what labelme and OpenCV show: turned as its EXIF note says, three channels of 8 bits
(grey repeated, alpha dropped, 16 bits shortened), at most ``MAX_SIDE_PX`` a side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.header import FORMATS, Header, read_header
from detector_training.datasets.names import LabelNames
from detector_training.datasets.values import MAX_SIDE_PX
from detector_training.errors import DatasetError
from target_pose.target import Level

CLASSES = tuple(level.value for level in Level)
"""The net's classes, in the order of its outputs."""

MAX_IMAGE_BYTES = 64 << 20
CORNER_PX = 0.5
"""A pixel's centre seen from its corner: theirs = ours + CORNER_PX."""


class LabelBox(NamedTuple):
    """One labelled box."""

    level: Level
    xyxy: tuple[float, float, float, float]
    """[px], from the centre of the first pixel."""
    visible: float
    """Share of the shape that is to be seen, [0, 1]."""


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
    recipe: str | None = None
    """Name of what the picture was rendered for; None where the data set does not say."""
    split: str | None = None
    """``train``, ``val`` or ``test`` where the data set says."""
    label: str = ""
    """Where the label stands, for messages: the file, and the line where one holds many."""

    def read(self) -> NDArray[np.uint8]:
        """The picture, RGB (H, W, 3).

        Raises:
            DatasetError: it cannot be read or has another size than its label says.
        """
        return decode_image(self, read_bytes(self.image))

    @property
    def labels(self) -> tuple[LabelBox, ...]:
        """The boxes as plain values."""
        return tuple(
            LabelBox(Level(CLASSES[c]), (float(x0), float(y0), float(x1), float(y1)), float(v))
            for c, (x0, y0, x1, y1), v in zip(self.classes, self.boxes, self.visible, strict=True)
        )


def make_sample(
    image: Path,
    size: tuple[int, int],
    boxes: Sequence[LabelBox],
    conditions: tuple[str, ...] = (),
    *,
    distance_m: float | None = None,
    recipe: str | None = None,
    split: str | None = None,
    label: str = "",
) -> Sample:
    """A sample of plain values; one without boxes is a negative."""
    return Sample(
        image,
        *size,
        "scene" if boxes else "negative",
        conditions,
        np.array([b.xyxy for b in boxes], np.float32).reshape(-1, 4),
        np.array([CLASSES.index(b.level) for b in boxes], np.int64),
        np.array([b.visible for b in boxes], np.float32),
        distance_m,
        recipe,
        split,
        label,
    )


def share_inside(xyxy: Sequence[float], size: tuple[int, int]) -> float:
    """Share of a box that lies in a picture of ``size`` (width, height), [0, 1].

    The best guess of the visible share where a label does not tell: people label what they see.
    """
    x0, y0, x1, y1 = xyxy
    width = min(x1, size[0] - CORNER_PX) - max(x0, -CORNER_PX)
    height = min(y1, size[1] - CORNER_PX) - max(y0, -CORNER_PX)
    area = (x1 - x0) * (y1 - y0)
    return min(max(width, 0.0) * max(height, 0.0) / area, 1.0) if area > 0 else 0.0


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


def check_header(sample: Sample, data: bytes) -> Header:
    """The size in a picture's first bytes, checked against its label; nothing is decoded.

    Raises:
        DatasetError: the bytes are no picture, or one of another size than its label says.
    """
    header = read_header(data)
    if header is None:
        raise DatasetError(
            f"picture {sample.image} "
            + (f"cannot be decoded: damaged or none of {FORMATS}" if data else "is empty")
        )
    if (header.width, header.height) != (sample.width, sample.height):
        turned = f" (turned by its EXIF note {header.orientation}), which is what labels count in"
        raise DatasetError(
            f"picture {sample.image} is {header.width}x{header.height}"
            f"{turned if header.orientation != 1 else ''}, "
            f"its label says {sample.width}x{sample.height}"
        )
    if max(header.width, header.height) > MAX_SIDE_PX:
        raise DatasetError(
            f"picture {sample.image} is {header.width}x{header.height}; "
            f"at most {MAX_SIDE_PX} a side"
        )
    return header


def decode_image(sample: Sample, data: bytes) -> NDArray[np.uint8]:
    """The picture in ``data``, RGB (H, W, 3), checked against its label.

    Raises:
        DatasetError: the bytes are no picture or one of another size.
    """
    check_header(sample, data)  # first: a few kilobytes may unpack to gigabytes
    try:
        bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        bgr = None
    if bgr is None:
        raise DatasetError(f"picture {sample.image} cannot be decoded: damaged or cut off")
    if bgr.shape != (sample.height, sample.width, 3):
        raise DatasetError(
            f"picture {sample.image} decodes to {bgr.shape[1]}x{bgr.shape[0]}, "
            f"its header says {sample.width}x{sample.height}"
        )
    rgb: NDArray[np.uint8] = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
    return rgb


def load_dataset(path: Path, names: LabelNames | None = None) -> tuple[Sample, ...]:
    """All samples of a data set in any format that we read; see ``load.load_dataset``.

    Raises:
        DatasetError: names the file and what is wrong with it.
    """
    from detector_training.datasets import load  # its readers stand on this module

    return load.load_dataset(path, names)
