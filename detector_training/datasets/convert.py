"""Data sets written in each format: a folder of its own with the pictures copied into it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from detector_training.datasets import coco, labelme, lines, yolo
from detector_training.datasets.load import Format
from detector_training.datasets.output import copy_picture, new_folder, picture_names
from detector_training.datasets.sample import CORNER_PX, LabelBox, Sample, share_inside

OnProgress: TypeAlias = Callable[[int], None]
"""Called with the number of pictures done."""


@dataclass(frozen=True, slots=True)
class Written:
    """What went into a data set, and what the format could not hold."""

    pictures: int
    boxes: int
    clipped: int = 0
    """Boxes cut at the border of their picture."""
    dropped: int = 0
    """Boxes wholly outside of it."""
    turned: int = 0
    """Pictures that an EXIF note turns: labels count in what is shown, as labelme does."""
    lost: tuple[str, ...] = ()
    """Fields that the format has no place for, and that some picture had."""


def _quiet(done: int) -> None:
    """No progress."""


def write_lines(samples: Sequence[Sample], out: Path, on_progress: OnProgress = _quiet) -> Written:
    """Write ``images/`` and ``labels.jsonl``.

    Raises:
        DatasetError: ``out`` is taken or cannot be written, or a picture cannot be read.
    """
    turned = 0
    with new_folder(out) as folder:
        (folder / "images").mkdir()
        rows = []
        for done, (sample, name) in enumerate(_named(samples), 1):
            turned += copy_picture(sample, folder / "images" / name)
            rows.append(lines.line_of(sample, f"images/{name}") + "\n")
            on_progress(done)
        (folder / lines.LABELS).write_text("".join(rows), encoding="utf-8")
    return _all(samples, turned)


def write_labelme(
    samples: Sequence[Sample], out: Path, on_progress: OnProgress = _quiet
) -> Written:
    """Write pictures with a labelme JSON beside each.

    Raises:
        DatasetError: ``out`` is taken or cannot be written, or a picture cannot be read.
    """
    turned = 0
    with new_folder(out) as folder:
        for done, (sample, name) in enumerate(_named(samples), 1):
            turned += copy_picture(sample, folder / name)
            label = (folder / name).with_suffix(".json")
            label.write_text(labelme.label_text(sample, name), encoding="utf-8")
            on_progress(done)
    return _all(samples, turned)


def write_coco(samples: Sequence[Sample], out: Path, on_progress: OnProgress = _quiet) -> Written:
    """Write ``images/`` and ``annotations.json``.

    Raises:
        DatasetError: ``out`` is taken or cannot be written, or a picture cannot be read.
    """
    turned = 0
    names = [f"images/{name}" for name in picture_names(samples)]
    with new_folder(out) as folder:
        (folder / "images").mkdir()
        for done, (sample, name) in enumerate(zip(samples, names, strict=True), 1):
            turned += copy_picture(sample, folder / name)
            on_progress(done)
        (folder / coco.ANNOTATIONS).write_text(coco.coco_text(samples, names), encoding="utf-8")
    return _all(samples, turned)


def write_yolo(samples: Sequence[Sample], out: Path, on_progress: OnProgress = _quiet) -> Written:
    """Write ``images/SPLIT``, ``labels/SPLIT`` and ``data.yaml``; boxes are clipped at the border.

    Raises:
        DatasetError: ``out`` is taken or cannot be written, or a picture cannot be read.
    """
    boxes = clipped = dropped = turned = 0
    used: set[str] = set()
    with new_folder(out) as folder:
        for done, (sample, name) in enumerate(_named(samples), 1):
            split = sample.split if sample.split in yolo.SPLITS else "train"
            if split not in used:
                used.add(split)
                (folder / "images" / split).mkdir(parents=True)
                (folder / "labels" / split).mkdir(parents=True)
            size = sample.width, sample.height
            kept = [b for b in sample.labels if share_inside(b.xyxy, size) > 0]
            boxes += len(kept)
            dropped += len(sample.labels) - len(kept)
            clipped += sum(_reaches_over(b, size) for b in kept)
            turned += copy_picture(sample, folder / "images" / split / name)
            label = (folder / "labels" / split / name).with_suffix(".txt")
            label.write_text(yolo.label_text(kept, size), encoding="utf-8")
            on_progress(done)
        splits = [s for s in yolo.SPLITS if s in used]
        text = yolo.description_text(splits)
        (folder / yolo.DESCRIPTION).write_text(text, encoding="utf-8")
    return Written(len(samples), boxes, clipped, dropped, turned, _lost(samples))


WRITERS = {
    Format.LINES: write_lines,
    Format.LABELME: write_labelme,
    Format.YOLO: write_yolo,
    Format.COCO: write_coco,
}


def _named(samples: Sequence[Sample]) -> list[tuple[Sample, str]]:
    return list(zip(samples, picture_names(samples), strict=True))


def _all(samples: Sequence[Sample], turned: int) -> Written:
    return Written(len(samples), sum(len(s.boxes) for s in samples), turned=turned)


def _reaches_over(box: LabelBox, size: tuple[int, int]) -> bool:
    x0, y0, x1, y1 = (v + CORNER_PX for v in box.xyxy)
    return min(x0, y0) < 0 or x1 > size[0] or y1 > size[1]


def _lost(samples: Sequence[Sample]) -> tuple[str, ...]:
    fields = {
        "conditions": any(s.conditions for s in samples),
        "distance_m": any(s.distance_m is not None for s in samples),
        "recipe": any(s.recipe is not None for s in samples),
        "visible": any(
            abs(b.visible - share_inside(b.xyxy, (s.width, s.height))) > 0.01
            for s in samples
            for b in s.labels
        ),
    }
    return tuple(name for name, had in fields.items() if had)
