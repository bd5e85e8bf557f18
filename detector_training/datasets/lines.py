"""Our own format: ``images/*.jpg`` and ``labels.jsonl``, one JSON object per picture.

Fields: ``image width height kind conditions boxes``, each box with ``level xyxy visible``; where
known ``distance_m``, ``recipe`` and ``split``. A true box may reach over the picture's border, and
the visible share of each is in [0, 1].
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from detector_training.datasets.names import LabelNames
from detector_training.datasets.sample import LabelBox, Sample, make_sample
from detector_training.datasets.values import (
    MAX_BOXES,
    MAX_JSON_BYTES,
    as_distance,
    as_key,
    as_list,
    as_number,
    as_object,
    as_share,
    as_side,
    as_text,
    parse_json,
    shown,
)
from detector_training.errors import DatasetError

LABELS = "labels.jsonl"
MAX_PICTURES = 1_000_000


def read_lines(path: Path, names: LabelNames) -> Iterator[Sample | DatasetError]:
    """The samples of a ``labels.jsonl``; an error in place of each that is wrong.

    Raises:
        DatasetError: the file as a whole cannot be read.
    """
    try:
        if path.stat().st_size > MAX_JSON_BYTES:
            raise DatasetError(f"{path} is over {MAX_JSON_BYTES} bytes")
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                if number > MAX_PICTURES:
                    raise DatasetError(f"{path} has over {MAX_PICTURES} lines")
                where = f"{path} line {number}"
                try:
                    yield _sample(path.parent, parse_json(line), names, where)
                except DatasetError as error:
                    yield DatasetError(f"{where}: {error}")
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path} is no UTF-8 text: {error.reason}") from None


def line_of(sample: Sample, image: str) -> str:
    """The line of a sample whose picture is stored as ``image``, without its end."""
    raw: dict[str, Any] = {
        "image": image,
        "width": sample.width,
        "height": sample.height,
        "kind": sample.kind,
        "conditions": list(sample.conditions),
        "distance_m": sample.distance_m,
        "boxes": [
            {
                "level": b.level.value,
                "xyxy": [round(v, 3) for v in b.xyxy],
                "visible": round(b.visible, 4),
            }
            for b in sample.labels
        ],
    }
    extra = {"recipe": sample.recipe, "split": sample.split}
    return json.dumps(raw | {k: v for k, v in extra.items() if v is not None})


def _sample(folder: Path, line: Any, names: LabelNames, where: str) -> Sample:
    raw = as_object(line, "a line")
    name = PurePosixPath(as_text(as_key(raw, "image"), "image"))
    if not name.parts or name.is_absolute() or ".." in name.parts:
        raise DatasetError(f"image {str(name)!r} leaves the data set's folder")
    path = folder / name
    if name.parts[0] != "images":  # the label may name the file alone
        path = folder / "images" / name
    size = as_side(as_key(raw, "width"), "width"), as_side(as_key(raw, "height"), "height")
    kind = as_key(raw, "kind")
    if kind not in ("scene", "negative"):
        raise DatasetError(f"kind {shown(kind)} is neither scene nor negative")
    entries = as_list(as_key(raw, "boxes"), "boxes", MAX_BOXES)
    boxes = [box for entry in entries if (box := _box(entry, names)) is not None]
    conditions = as_list(as_key(raw, "conditions"), "conditions", MAX_BOXES)
    return make_sample(
        path,
        size,
        boxes,
        tuple(as_text(c, "a condition") for c in conditions),
        distance_m=as_distance(raw.get("distance_m")),
        recipe=None if (r := raw.get("recipe")) is None else as_text(r, "recipe"),
        split=None if (s := raw.get("split")) is None else as_text(s, "split"),
        label=where,
    )


def _box(entry: Any, names: LabelNames) -> LabelBox | None:
    raw = as_object(entry, "a box")
    level = names.level(as_key(raw, "level"))
    corners = as_list(as_key(raw, "xyxy"), "xyxy")
    if len(corners) != 4:
        raise DatasetError(f"xyxy must be four finite pixels, not {shown(corners)}")
    x0, y0, x1, y1 = (as_number(x, "xyxy") for x in corners)
    if not (x0 < x1 and y0 < y1):
        raise DatasetError(f"xyxy must be x0 < x1, y0 < y1, not {shown(corners)}")
    visible = as_share(as_key(raw, "visible"), "visible")
    return None if level is None else LabelBox(level, (x0, y0, x1, y1), visible)
