"""COCO: one JSON file with ``images``, ``annotations`` and ``categories``.

``bbox`` is x, y, width, height from the corner of the first pixel and may reach over the border.
Crowds (``iscrowd``) are left out. What COCO does not know (conditions, distance_m, recipe, split,
visible) is written as keys of its own, which COCO tools pass over.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from detector_training.datasets.files import is_file
from detector_training.datasets.names import LabelNames
from detector_training.datasets.sample import (
    CLASSES,
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

ANNOTATIONS = "annotations.json"
KEYS = ("images", "annotations", "categories")
_DIGITS = 4


def read_coco(path: Path, names: LabelNames) -> Iterator[Sample | DatasetError]:
    """The samples of a COCO file; an error in place of each that is wrong.

    Raises:
        DatasetError: the file as a whole cannot be read.
    """
    try:
        raw = as_object(read_json(path), "a COCO file")
        images = as_list(as_key(raw, "images"), "images")
        categories = _by_id(as_list(as_key(raw, "categories"), "categories"), "category")
        _by_id(images, "image")
        of_image: defaultdict[Hashable, list[tuple[int, dict[str, Any]]]] = defaultdict(list)
        for number, entry in enumerate(as_list(as_key(raw, "annotations"), "annotations"), 1):
            annotation = as_object(entry, f"annotation {number}")
            of_image[_id(as_key(annotation, "image_id"))].append((number, annotation))
    except DatasetError as error:
        raise DatasetError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    folders = _folders(path)
    for entry in images:
        mine = of_image.pop(entry["id"], [])
        yield from _entries(path, folders, entry, mine, categories, names)
    for key, left in of_image.items():
        number = left[0][0]
        yield DatasetError(f"{path} annotation {number}: no image has the id {shown(key)}")


def coco_text(samples: Sequence[Sample], images: Sequence[str]) -> str:
    """The COCO file of samples whose pictures are stored as ``images``."""
    annotations: list[dict[str, Any]] = []
    for image_id, sample in enumerate(samples, 1):
        for box in sample.labels:
            x0, y0, x1, y1 = (v + CORNER_PX for v in box.xyxy)
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": image_id,
                    "category_id": CLASSES.index(box.level) + 1,
                    "bbox": [round(v, _DIGITS) for v in (x0, y0, x1 - x0, y1 - y0)],
                    "area": round((x1 - x0) * (y1 - y0), _DIGITS),
                    "iscrowd": 0,
                    "segmentation": [],
                    "visible": round(box.visible, _DIGITS),
                }
            )
    raw = {
        "images": [
            _image(i, sample, name)
            for i, (sample, name) in enumerate(zip(samples, images, strict=True), 1)
        ],
        "annotations": annotations,
        "categories": [
            {"id": i, "name": name, "supercategory": "target"} for i, name in enumerate(CLASSES, 1)
        ],
    }
    return json.dumps(raw) + "\n"


def _image(image_id: int, sample: Sample, name: str) -> dict[str, Any]:
    raw = {"id": image_id, "file_name": name, "width": sample.width, "height": sample.height}
    extra = {
        "conditions": list(sample.conditions) or None,
        "distance_m": sample.distance_m,
        "recipe": sample.recipe,
        "split": sample.split,
    }
    return raw | {k: v for k, v in extra.items() if v is not None}


def _entries(
    path: Path,
    folders: Sequence[Path],
    raw: dict[str, Any],
    annotations: Sequence[tuple[int, dict[str, Any]]],
    categories: dict[Hashable, dict[str, Any]],
    names: LabelNames,
) -> Iterator[Sample | DatasetError]:
    where = f"{path} image {shown(raw['id'])}"
    try:
        image = _find(folders, as_text(as_key(raw, "file_name"), "file_name"))
        size = as_side(as_key(raw, "width"), "width"), as_side(as_key(raw, "height"), "height")
        if len(annotations) > MAX_BOXES:
            raise DatasetError(f"over {MAX_BOXES} annotations")
        extra = {k: as_text(raw[k], k) for k in ("recipe", "split") if raw.get(k) is not None}
        distance = as_distance(raw.get("distance_m"))
        noted = as_list(raw.get("conditions", []), "conditions", MAX_BOXES)
        conditions = tuple(as_text(c, "a condition") for c in noted)
    except DatasetError as error:
        yield DatasetError(f"{where}: {error}")
        return
    boxes: list[LabelBox] = []
    wrong = False
    for number, annotation in annotations:
        try:
            if (box := _box(annotation, size, categories, names)) is not None:
                boxes.append(box)
        except DatasetError as error:
            wrong = True
            yield DatasetError(f"{path} annotation {number} ({image.name}): {error}")
    if not wrong:
        label = f"{path} image {shown(raw['id'])}"
        yield make_sample(image, size, boxes, conditions, distance_m=distance, label=label, **extra)


def _box(
    raw: dict[str, Any],
    size: tuple[int, int],
    categories: dict[Hashable, dict[str, Any]],
    names: LabelNames,
) -> LabelBox | None:
    if raw.get("iscrowd"):
        return None
    key = _id(as_key(raw, "category_id"))
    if key not in categories:
        raise DatasetError(f"category_id {shown(key)} is not one of the categories")
    level = names.level(as_key(categories[key], "name"))
    if level is None:
        return None
    bbox = as_list(as_key(raw, "bbox"), "bbox")
    if len(bbox) != 4:
        raise DatasetError(f"bbox must be x, y, width, height, not {shown(bbox)}")
    x, y, w, h = (as_number(v, "bbox") for v in bbox)
    if not (w > 0 and h > 0):
        raise DatasetError(f"{level} has no area: bbox {shown(bbox)}")
    xyxy = x - CORNER_PX, y - CORNER_PX, x + w - CORNER_PX, y + h - CORNER_PX
    visible = raw.get("visible")
    share = share_inside(xyxy, size) if visible is None else as_share(visible, "visible")
    return LabelBox(level, xyxy, share)


def _folders(path: Path) -> tuple[Path, ...]:
    """Where the pictures of a COCO file are looked for, the likeliest first."""
    here, above = path.parent, path.parent.parent
    folders = [here, here / "images"]
    if here.name == "annotations":
        # annotations/instances_val2017.json belongs to val2017/
        part = path.stem.rpartition("_")[2]
        folders += [above, above / "images", above / part, above / "images" / part]
    return tuple(folders)


def _find(folders: Sequence[Path], name: str) -> Path:
    relative = PurePosixPath(name)
    if not relative.parts or relative.is_absolute() or ".." in relative.parts:
        raise DatasetError(f"file_name {shown(name)} leaves the data set's folder")
    return next((p for f in folders if is_file(p := f / relative)), folders[0] / relative)


def _by_id(entries: Sequence[Any], what: str) -> dict[Hashable, dict[str, Any]]:
    found: dict[Hashable, dict[str, Any]] = {}
    for number, entry in enumerate(entries, 1):
        raw = as_object(entry, f"{what} {number}")
        key = _id(raw.get("id"))
        if key in found:
            raise DatasetError(f"two of the {what} ids are {shown(key)}")
        found[key] = raw
    return found


def _id(raw: Any) -> int | str:
    if isinstance(raw, bool) or not isinstance(raw, int | str):
        raise DatasetError(f"an id must be a whole number or a text, not {shown(raw)}")
    return raw
