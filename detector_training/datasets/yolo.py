"""YOLO: ``data.yaml`` with the names, and a text file of normalised boxes for each picture.

A label lies in ``labels/`` where its picture lies in ``images/``, or beside it. A line is ``class
cx cy w h``, or ``class x y x y x y ...`` around a polygon, in shares of the picture's sides counted
from the corner of the first pixel. A picture without a text file shows no target. YOLO tools refuse
what leaves [0, 1]: boxes over the border are clipped when written, and nothing else is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from detector_training.datasets.files import MAX_FILES, is_file, walk
from detector_training.datasets.header import SUFFIXES, picture_header
from detector_training.datasets.names import LabelNames
from detector_training.datasets.sample import (
    CLASSES,
    CORNER_PX,
    LabelBox,
    Sample,
    make_sample,
    share_inside,
)
from detector_training.datasets.values import MAX_BOXES, as_number, as_side, read_text, shown
from detector_training.errors import DatasetError

DESCRIPTION = "data.yaml"
CLASS_FILE = "classes.txt"
SPLITS = ("train", "val", "test")
MAX_TEXT_BYTES = 1 << 20
MAX_LIST_BYTES = 64 << 20
MAX_CLASSES = 10_000
_PARENTS = 3
"""How far above a folder of pictures its data.yaml is looked for."""
_MOST = 100.0
"""A share beyond this is no slip of the hand but another unit: pixels."""


def find_description(folder: Path) -> Path | None:
    """The file with the names: in the folder, or above a folder of pictures with labels."""
    for name in (DESCRIPTION, "data.yml", "dataset.yaml"):
        if is_file(folder / name):
            return folder / name
    others = [p for s in ("*.yaml", "*.yml") for p in sorted(folder.glob(s)) if _has_names(p)]
    if len(others) == 1:
        return others[0]
    if not looks_labelled(folder):
        return None
    above = folder.absolute()
    for _ in range(_PARENTS + 1):
        for name in (DESCRIPTION, CLASS_FILE):
            if is_file(above / name):
                return above / name
        if is_file(above / "labels" / CLASS_FILE):
            return above / "labels" / CLASS_FILE
        above = above.parent
    return None


def looks_labelled(folder: Path) -> bool:
    """Whether the first pictures below a folder have text files of labels."""
    for number, picture in enumerate(walk(folder, SUFFIXES)):
        if number >= 100:
            break
        if label_of(picture) is not None:
            return True
    return False


def label_of(picture: Path) -> Path | None:
    """The text file of a picture, where there is one."""
    return next((p for p in _label_paths(picture) if is_file(p)), None)


def read_yolo(
    folder: Path, description: Path, names: LabelNames
) -> Iterator[Sample | DatasetError]:
    """The samples of a data set; an error in place of each label that is wrong.

    Args:
        folder: What was asked for: the data set, or a folder of pictures in it.
        description: Its ``data.yaml`` or ``classes.txt``.
        names: What its classes mean.

    Raises:
        DatasetError: the description or a list of pictures is wrong.
    """
    classes, sources = _describe(folder, description)
    labelled = 0
    for split, picture in sources:
        label = label_of(picture)
        labelled += label is not None
        try:
            header = picture_header(picture)
            size = as_side(header.width, "width"), as_side(header.height, "height")
        except DatasetError as error:
            text = str(error)
            yield DatasetError(text if str(picture) in text else f"picture {picture}: {text}")
            continue
        yield from _entries(picture, label, size, classes, names, split)
    if not labelled:
        raise DatasetError(f"{description}: no picture has a label; looked in labels/ and beside")


def labels_without_picture(folder: Path) -> Iterator[Path]:
    """Text files in folders called ``labels`` that no picture belongs to."""
    pictures = {p for picture in walk(folder, SUFFIXES) for p in _label_paths(picture)}
    for path in walk(folder, {".txt"}):
        if "labels" in path.parts and path.name != CLASS_FILE and path not in pictures:
            yield path


def label_text(boxes: Sequence[LabelBox], size: tuple[int, int]) -> str:
    """The text file of boxes that lie in the picture."""
    lines = []
    for box in boxes:
        x0, y0, x1, y1 = (
            min(max((v + CORNER_PX) / size[i % 2], 0.0), 1.0) for i, v in enumerate(box.xyxy)
        )
        shares = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0
        lines.append(f"{CLASSES.index(box.level)} " + " ".join(f"{s:.8f}" for s in shares) + "\n")
    return "".join(lines)


def description_text(splits: Sequence[str]) -> str:
    """The ``data.yaml`` of a data set with pictures in ``images/SPLIT`` for each split."""
    lines = [f"{s}: images/{s}\n" for s in splits]
    for needed in ("train", "val"):  # YOLO trainers insist on both
        if needed not in splits:
            lines.append(f"{needed}: images/{splits[0]}  # the same pictures: none held out\n")
    classes = "".join(f"  {i}: {name}\n" for i, name in enumerate(CLASSES))
    return "".join(lines) + f"names:\n{classes}"


def _entries(
    picture: Path,
    label: Path | None,
    size: tuple[int, int],
    classes: dict[int, str],
    names: LabelNames,
    split: str | None,
) -> Iterator[Sample | DatasetError]:
    boxes: list[LabelBox] = []
    wrong = False
    if label is not None:
        try:
            text = read_text(label, MAX_TEXT_BYTES)
        except DatasetError as error:
            yield error
            return
        for number, line in enumerate(text.splitlines(), 1):
            try:
                if line.strip() and (box := _box(line, size, classes, names)) is not None:
                    boxes.append(box)
                if len(boxes) > MAX_BOXES:
                    raise DatasetError(f"over {MAX_BOXES} boxes")
            except DatasetError as error:
                wrong = True
                yield DatasetError(f"{label} line {number}: {error}")
    if not wrong:
        yield make_sample(picture, size, boxes, split=split, label=str(label or picture))


def _box(
    line: str, size: tuple[int, int], classes: dict[int, str], names: LabelNames
) -> LabelBox | None:
    words = line.split()
    try:
        values = [as_number(float(w), "a value", math.inf) for w in words]
    except ValueError:
        raise DatasetError(f"must be numbers, not {shown(line.strip())}") from None
    shares = [as_number(v, "a share of the picture's side", _MOST) for v in values[1:]]
    index = values[0]
    if index not in classes:
        raise DatasetError(f"class {words[0]} is not one of the {len(classes)} in the names")
    level = names.level(classes[int(index)])
    if level is None:
        return None
    if len(shares) == 4:
        cx, cy, w, h = shares
        x0, y0, x1, y1 = cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2
    elif len(shares) >= 6 and len(shares) % 2 == 0:
        xs, ys = shares[::2], shares[1::2]
        x0, y0, x1, y1 = min(xs), min(ys), max(xs), max(ys)
    else:
        hint = "; is it a prediction with a confidence?" if len(words) == 6 else ""
        raise DatasetError(
            f"{len(words)} numbers; a box has 5, a polygon 7 or 9 or more odd ones{hint}"
        )
    if not (x0 < x1 and y0 < y1):
        raise DatasetError(f"{level} has no area: {shown(line.strip())}")
    xyxy = (
        x0 * size[0] - CORNER_PX,
        y0 * size[1] - CORNER_PX,
        x1 * size[0] - CORNER_PX,
        y1 * size[1] - CORNER_PX,
    )
    return LabelBox(level, xyxy, share_inside(xyxy, size))


def _label_paths(picture: Path) -> tuple[Path, ...]:
    parts = picture.parts
    places = [i for i, part in enumerate(parts) if part == "images"]
    beside = picture.with_suffix(".txt")
    if not places:
        return (beside,)
    at = places[-1]
    return Path(*parts[:at], "labels", *parts[at + 1 :]).with_suffix(".txt"), beside


def _describe(
    folder: Path, description: Path
) -> tuple[dict[int, str], Iterator[tuple[str | None, Path]]]:
    """Names of the classes, and the pictures with their splits."""
    if description.name == CLASS_FILE:
        lines = read_text(description, MAX_TEXT_BYTES).splitlines()
        classes = {i: line.strip() for i, line in enumerate(lines[:MAX_CLASSES])}
        return classes, ((None, p) for p in walk(folder, SUFFIXES))
    raw = _yaml(description)
    classes = _names(raw.get("names"), description)
    root = description.parent
    if folder.absolute() != root.absolute():  # one folder of pictures was asked for
        split = next((s for s in SPLITS if s in folder.parts[-2:]), None)
        return classes, ((split, p) for p in walk(folder, SUFFIXES))
    if isinstance(path := raw.get("path"), str) and (root / path).is_dir():
        root = root / path
    return classes, _pictures(raw, root, description)


def _pictures(
    raw: dict[str, Any], root: Path, description: Path
) -> Iterator[tuple[str | None, Path]]:
    given = [s for s in SPLITS if raw.get(s)]
    if not given:
        yield from ((None, p) for p in walk(root, SUFFIXES))
        return
    seen: set[Path] = set()
    for split in given:
        entries = raw[split] if isinstance(raw[split], list) else [raw[split]]
        for entry in entries:
            if not isinstance(entry, str):
                raise DatasetError(f"{description}: {split} must be a path or a list of paths")
            place = _place(root, entry)
            if place is None:
                raise DatasetError(f"{description}: {split}: {shown(entry)} is not there")
            if place in seen:  # none held out: val and train are one folder, and it has a name
                continue
            seen.add(place)
            found = walk(place, SUFFIXES) if place.is_dir() else _listed(place)
            called = place.name if place.name in SPLITS else split
            yield from ((called, p) for p in found)


def _place(root: Path, entry: str) -> Path | None:
    """A folder or list of pictures; ``../train/images`` is also looked for without its dots."""
    plain = entry
    while plain.startswith("../"):
        plain = plain[3:]
    for place in (root / entry, root / plain):
        try:
            if place.exists():
                return place
        except (OSError, ValueError):
            continue
    return None


def _listed(path: Path) -> Iterator[Path]:
    lines = read_text(path, MAX_LIST_BYTES).splitlines()
    if len(lines) > MAX_FILES:
        raise DatasetError(f"{path} lists over {MAX_FILES} pictures")
    for line in lines:
        if text := line.strip():
            if not text.isprintable():
                raise DatasetError(f"{path} is no list of pictures")
            yield path.parent / text


def _has_names(path: Path) -> bool:
    try:
        return bool(_yaml(path).get("names"))
    except DatasetError:
        return False


def _yaml(path: Path) -> dict[str, Any]:
    try:
        # BaseLoader: texts, lists and mappings alone; a tag constructs nothing
        raw = yaml.load(read_text(path, MAX_TEXT_BYTES), Loader=yaml.BaseLoader)
    except yaml.YAMLError as error:
        raise DatasetError(f"{path} is no YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise DatasetError(f"{path} is nested too deeply") from None
    if not isinstance(raw, dict):
        raise DatasetError(f"{path} must be a mapping with names, train and val")
    return raw


def _names(raw: Any, path: Path) -> dict[int, str]:
    pairs = list(enumerate(raw)) if isinstance(raw, list) else None
    if isinstance(raw, dict):
        try:
            pairs = [(int(key), name) for key, name in raw.items()]
        except (ValueError, TypeError):
            pairs = None
    if not pairs or len(pairs) > MAX_CLASSES or not all(isinstance(n, str) for _, n in pairs):
        raise DatasetError(f"{path}: names must list the classes, as in [{', '.join(CLASSES)}]")
    return dict(pairs)
