"""A data set of any format that we read, recognised by what lies there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from detector_training.datasets import yolo
from detector_training.datasets.coco import KEYS, read_coco
from detector_training.datasets.files import is_file, walk
from detector_training.datasets.labelme import read_labelme
from detector_training.datasets.lines import LABELS, read_lines
from detector_training.datasets.names import LabelNames
from detector_training.datasets.sample import Sample
from detector_training.errors import DatasetError

_SNIFF_BYTES = 64 << 10
_LOOKED_FOR = (
    f"looked for {LABELS}, labelme's .json files, a COCO .json (also in annotations/), and YOLO's "
    f"{yolo.DESCRIPTION} or {yolo.CLASS_FILE}"
)


class Format(StrEnum):
    """What a data set is stored as."""

    LINES = "lines"
    LABELME = "labelme"
    YOLO = "yolo"
    COCO = "coco"


class Found(NamedTuple):
    """A data set that was recognised."""

    format: Format
    path: Path
    """The file that describes it all; the folder for labelme."""
    folder: Path
    """What was asked for, where the pictures are looked for."""


def recognise(path: Path) -> Found:
    """The format of the data set in a folder or file.

    Raises:
        DatasetError: there is none, or more than one; says what was looked for.
    """
    if path.is_dir():
        return _in_folder(path)
    if not is_file(path):
        raise DatasetError(f"no data set in {path}: no such folder or file")
    match path.suffix.lower():
        case ".jsonl":
            return Found(Format.LINES, path, path.parent)
        case ".yaml" | ".yml":
            return Found(Format.YOLO, path, path.parent)
        case ".json" if _sniff(path) is Format.COCO:
            return Found(Format.COCO, path, path.parent)
        case ".json" if _sniff(path) is Format.LABELME:
            raise DatasetError(f"{path} is one label of labelme; give its folder")
    raise DatasetError(
        f"{path} is no data set; give its folder, a {LABELS}, {yolo.DESCRIPTION} or COCO .json"
    )


def read_entries(found: Found, names: LabelNames) -> Iterator[Sample | DatasetError]:
    """Every picture of a data set; an error in place of each label that is wrong.

    Raises:
        DatasetError: a file that describes the whole data set cannot be read.
    """
    match found.format:
        case Format.LINES:
            return read_lines(found.path, names)
        case Format.LABELME:
            return read_labelme(found.path, names)
        case Format.YOLO:
            return yolo.read_yolo(found.folder, found.path, names)
        case Format.COCO:
            return read_coco(found.path, names)


def load_dataset(path: Path, names: LabelNames | None = None) -> tuple[Sample, ...]:
    """All samples of a data set, in the order of its labels.

    Args:
        path: The data set's folder, or the file that holds its labels.
        names: What its labels mean, where they are not called as the levels are.

    Raises:
        DatasetError: names the file and what is wrong with it.
    """
    samples: list[Sample] = []
    for entry in read_entries(recognise(path), names or LabelNames()):
        if isinstance(entry, DatasetError):
            raise entry
        samples.append(entry)
    if not samples:
        raise DatasetError(f"the data set in {path} has no pictures")
    return tuple(samples)


def _in_folder(folder: Path) -> Found:
    found = list(_candidates(folder))
    if not found:
        hint = ""
        if yolo.looks_labelled(folder):
            hint = f"; there are YOLO labels, but no {yolo.DESCRIPTION} that names their classes"
        raise DatasetError(f"no data set in {folder}: {_LOOKED_FOR}{hint}")
    if len(found) > 1:
        which = ", ".join(f"{f.format} ({f.path})" for f in found[:4])
        raise DatasetError(
            f"{folder} holds {len(found)} data sets: {which}; give the path of the one you mean"
        )
    return found[0]


def _candidates(folder: Path) -> Iterator[Found]:
    if is_file(folder / LABELS):
        yield Found(Format.LINES, folder / LABELS, folder)
    for place in (folder, folder / "annotations"):
        for path in sorted(place.glob("*.json")):
            if _sniff(path) is Format.COCO:
                yield Found(Format.COCO, path, folder)
    if any(_sniff(path) is Format.LABELME for path in walk(folder, {".json"})):
        yield Found(Format.LABELME, folder, folder)
    if description := yolo.find_description(folder):
        yield Found(Format.YOLO, description, folder)


def _sniff(path: Path) -> Format | None:
    """What a JSON file seems to be, from its beginning and end: labelme may embed a picture."""
    try:
        with path.open("rb") as file:
            text = file.read(_SNIFF_BYTES)
            end = file.seek(0, 2)
            file.seek(max(end - _SNIFF_BYTES, 0))
            text += file.read(_SNIFF_BYTES)
    except OSError:
        return None
    if re.search(rb'"(shapes|imagePath)"\s*:', text):
        return Format.LABELME
    keys = [rf'"{key}"\s*:'.encode() for key in KEYS]
    # a large file shows two of the three at its ends
    if sum(re.search(key, text) is not None for key in keys) >= (2 if end > _SNIFF_BYTES else 3):
        return Format.COCO
    return None
