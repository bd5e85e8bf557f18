"""labelme: one JSON file beside each picture, nested folders included.

Coordinates count from the corner of the first pixel; a shape may reach over the border. The flags
of a picture are its conditions. labelme keeps keys that it does not know, of the file and of each
shape, when it saves: there go ``distance_m``, ``recipe``, ``split`` and ``visible``.
A JSON file without shapes is a picture without a target.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path, PureWindowsPath
from typing import Any

from detector_training.datasets.conditions import PAPER_CONDITIONS
from detector_training.datasets.files import inside, is_file, walk
from detector_training.datasets.header import picture_header
from detector_training.datasets.names import LabelNames
from detector_training.datasets.sample import (
    CORNER_PX,
    LabelBox,
    Sample,
    make_sample,
    share_inside,
)
from detector_training.datasets.values import (
    MAX_BOXES,
    as_distance,
    as_key,
    as_list,
    as_number,
    as_object,
    as_share,
    as_side,
    as_text,
    read_json,
    shown,
)
from detector_training.errors import DatasetError

VERSION = "5.5.0"
"""The layout of this release and all later ones."""
_DIGITS = 4
_EXTRA = ("recipe", "split")
_HULLS = {"rectangle": 2, "polygon": 3, "oriented_rectangle": 4}
"""Shapes that their points' box is drawn around, and how many points they have at least."""


def read_labelme(folder: Path, names: LabelNames) -> Iterator[Sample | DatasetError]:
    """The samples of a folder; an error in place of each label that is wrong.

    Raises:
        DatasetError: the folder cannot be listed.
    """
    for path in walk(folder, {".json"}):
        try:
            raw = read_json(path)
            if isinstance(raw, dict) and "shapes" not in raw and "imagePath" not in raw:
                continue  # another kind of file: a camera's, our own dataset.json
            yield from _entries(folder, path, as_object(raw, "a label"), names)
        except DatasetError as error:
            yield DatasetError(_at(path, error))


def label_text(sample: Sample, image: str) -> str:
    """The JSON text of a sample whose picture lies beside it as ``image``."""
    flags = dict.fromkeys(PAPER_CONDITIONS, False) | dict.fromkeys(sample.conditions, True)
    extra = {"distance_m": sample.distance_m, "recipe": sample.recipe, "split": sample.split}
    raw = {
        "version": VERSION,
        "flags": flags,
        "shapes": [_shape(box) for box in sample.labels],
        "imagePath": image,
        "imageData": None,
        "imageHeight": sample.height,
        "imageWidth": sample.width,
    }
    return json.dumps(raw | {k: v for k, v in extra.items() if v is not None}, indent=2) + "\n"


def _shape(box: LabelBox) -> dict[str, Any]:
    x0, y0, x1, y1 = (round(v + CORNER_PX, _DIGITS) for v in box.xyxy)
    return {
        "label": box.level.value,
        "points": [[x0, y0], [x1, y1]],
        "group_id": None,
        "description": "",
        "shape_type": "rectangle",
        "flags": {},
        "mask": None,
        "visible": round(box.visible, _DIGITS),
    }


def _entries(
    folder: Path, path: Path, raw: dict[str, Any], names: LabelNames
) -> Iterator[Sample | DatasetError]:
    image = _image(folder, path, raw)
    size = _size(image, raw)
    boxes: list[LabelBox] = []
    wrong = False
    for number, entry in enumerate(as_list(as_key(raw, "shapes"), "shapes", MAX_BOXES), 1):
        try:
            if (box := _box(as_object(entry, "a shape"), names, size)) is not None:
                boxes.append(box)
        except DatasetError as error:
            wrong = True
            yield DatasetError(f"{path} shape {number}: {error}")
    if not wrong:
        extra = {k: as_text(raw[k], k) for k in _EXTRA if raw.get(k) is not None}
        yield make_sample(
            image,
            size,
            boxes,
            _conditions(raw.get("flags")),
            distance_m=as_distance(raw.get("distance_m")),
            label=str(path),
            **extra,
        )


def _image(folder: Path, path: Path, raw: dict[str, Any]) -> Path:
    """The picture of a label; one with another machine's path is looked for beside it."""
    text = as_text(as_key(raw, "imagePath"), "imagePath")
    given = PureWindowsPath(text)  # takes both kinds of slashes
    if given.drive or given.root:
        image = path.parent / given.name
        if not is_file(image):
            raise DatasetError(f"imagePath {shown(text)} is not relative, and not found beside it")
        return image
    image = Path(os.path.normpath(path.parent / given.as_posix()))
    if not inside(folder, image):
        raise DatasetError(
            f"imagePath {shown(text)} leaves {folder}; give the folder that has both"
        )
    return image


def _size(image: Path, raw: dict[str, Any]) -> tuple[int, int]:
    sides = [raw.get("imageWidth"), raw.get("imageHeight")]
    if None not in sides:
        return as_side(sides[0], "imageWidth"), as_side(sides[1], "imageHeight")
    header = picture_header(image)
    return as_side(header.width, "width"), as_side(header.height, "height")


def _conditions(raw: Any) -> tuple[str, ...]:
    if raw is None:
        return ()
    flags = as_object(raw, "flags")
    for name, value in flags.items():
        if not isinstance(value, bool):
            raise DatasetError(f"flag {shown(name)} must be true or false, not {shown(value)}")
    return tuple(as_text(name, "a flag") for name, value in flags.items() if value)


def _box(raw: dict[str, Any], names: LabelNames, size: tuple[int, int]) -> LabelBox | None:
    level = names.level(as_key(raw, "label"))
    if level is None:
        return None
    x0, y0, x1, y1 = (v - CORNER_PX for v in _hull(raw))
    if not (x0 < x1 and y0 < y1):
        raise DatasetError(f"{level} has no area; draw it again or delete it")
    xyxy = x0, y0, x1, y1
    visible = raw.get("visible")
    share = share_inside(xyxy, size) if visible is None else as_share(visible, "visible")
    return LabelBox(level, xyxy, share)


def _hull(raw: dict[str, Any]) -> Sequence[float]:
    """x0, y0, x1, y1 around a shape, from the corner of the first pixel [px]."""
    kind = raw.get("shape_type") or "polygon"  # as labelme reads it
    points = [_point(p) for p in as_list(as_key(raw, "points"), "points", 100_000)]
    if kind == "circle":
        if len(points) != 2:
            raise DatasetError(f"a circle has a centre and a point of its rim, not {len(points)}")
        (x, y), rim = points
        r = math.dist((x, y), rim)
        return x - r, y - r, x + r, y + r
    if not isinstance(kind, str) or kind not in _HULLS:
        known = ", ".join(("circle", *_HULLS))
        raise DatasetError(f"a {shown(kind)} has no box; draw one of {known}")
    if len(points) < _HULLS[kind] or (kind == "rectangle" and len(points) != 2):
        raise DatasetError(f"a {kind} has {_HULLS[kind]} points at least, not {len(points)}")
    xs, ys = [p[0] for p in points], [p[1] for p in points]
    return min(xs), min(ys), max(xs), max(ys)


def _point(raw: Any) -> tuple[float, float]:
    pair = as_list(raw, "a point")
    if len(pair) != 2:
        raise DatasetError(f"a point is [x, y], not {shown(pair)}")
    return as_number(pair[0], "x"), as_number(pair[1], "y")


def _at(path: Path, error: DatasetError) -> str:
    text = str(error)
    return text if str(path) in text else f"{path}: {text}"
