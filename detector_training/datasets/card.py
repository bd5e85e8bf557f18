"""A card that tells others what a data set holds: Markdown, made from the data set alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from detector_training.datasets.files import is_file
from detector_training.datasets.fingerprint import digest
from detector_training.datasets.load import Found
from detector_training.datasets.sample import Sample, read_bytes
from detector_training.datasets.stats import SPLIT_UNKNOWN, Spread, Stats
from detector_training.datasets.values import as_object, read_json

CARD = "DATASET_CARD.md"
DESCRIPTION = "dataset.json"
_FORMATS = {
    "lines": "labels.jsonl, one JSON object a picture; pixel (0, 0) is the centre of the first one",
    "labelme": "labelme JSON beside the pictures",
    "yolo": "YOLO, normalised boxes in text files",
    "coco": "COCO JSON",
}


def read_description(folder: Path) -> dict[str, Any]:
    """The data set's own ``dataset.json``, empty where there is none.

    Raises:
        DatasetError: it is damaged.
    """
    path = folder / DESCRIPTION
    if not is_file(path):
        return {}
    return as_object(read_json(path), str(path))


def handed_on(description: Mapping[str, Any], made_from: Path, command: str) -> str:
    """The ``dataset.json`` of a data set made from another one: its licences stay with it."""
    kept = {k: description[k] for k in ("target", "licences", "backgrounds") if k in description}
    raw = {"command": command, "made_from": str(made_from), **kept}
    return json.dumps(raw, indent=2) + "\n"


def hash_dataset(
    samples: Sequence[Sample], on_progress: Callable[[int], None] = lambda done: None
) -> tuple[str, str]:
    """SHA-256 over all pictures and over all labels, whatever the format and order.

    Raises:
        DatasetError: a picture cannot be read.
    """
    pictures, labels = [], []
    for done, sample in enumerate(samples, 1):
        key = digest(read_bytes(sample.image))
        pictures.append(key)
        boxes = sorted((b.level.value, [round(v, 2) for v in b.xyxy]) for b in sample.labels)
        labels.append(f"{key} {boxes}")
        on_progress(done)
    joined = ("\n".join(sorted(part)) for part in (pictures, labels))
    whole = [hashlib.sha256(text.encode()).hexdigest() for text in joined]
    return whole[0], whole[1]


def card_text(
    found: Found, stats: Stats, hashes: tuple[str, str], description: Mapping[str, Any]
) -> str:
    """The card.

    Args:
        found: Where the data set is, and its format.
        stats: Its numbers.
        hashes: Of its pictures and of its labels.
        description: Its ``dataset.json``, where it has one.
    """
    name = found.folder.absolute().name
    parts = [
        f"# Data set {name}",
        f"{stats.pictures} pictures, {stats.with_target} of them with a target and "
        f"{stats.negatives} without. The labels {', '.join(stats.boxes)} name the nested parts of "
        "a printed target, from the outside in.",
        "## What and how",
        _how(found, stats, description),
        "## Conditions",
        "Pictures with a target that show each of the paper's eight conditions; one may show "
        "several.",
        _table(("condition", "pictures"), stats.conditions.items()),
        "## Boxes",
        _boxes(stats),
        "## Splits",
        _table(("split", "pictures"), _splits(stats, description)),
        "## Licences",
        _licences(description),
        "## Hashes",
        f"SHA-256 over the sorted hashes of the picture files: `{hashes[0]}`",
        f"SHA-256 over picture hashes and boxes: `{hashes[1]}`",
        "They do not change with the format or the order of the files.",
    ]
    return "\n\n".join(parts) + "\n"


def _how(found: Found, stats: Stats, description: Mapping[str, Any]) -> str:
    lines = [f"- format: {_FORMATS[found.format]}"]
    shown = list(stats.picture_sizes.items())[:5]
    sizes = ", ".join(f"{size} ({n})" for size, n in shown)
    lines.append(f"- picture sizes: {sizes}{' and others' if len(stats.picture_sizes) > 5 else ''}")
    for key in ("target", "recipe", "split", "seed", "made_from", "command"):
        if (value := description.get(key)) is not None:
            lines.append(f"- {key}: `{_plain(value)}`")
    if "command" not in description:
        lines.append("- who took and labelled the pictures, where and with which camera: (add)")
    return "\n".join(lines)


def _splits(stats: Stats, description: Mapping[str, Any]) -> list[tuple[str, int]]:
    said = str(description.get("split", SPLIT_UNKNOWN))  # of all pictures that say nothing else
    return [(said if k == SPLIT_UNKNOWN else k, n) for k, n in stats.splits.items()]


def _boxes(stats: Stats) -> str:
    header = ("what", "number", "least", "10 %", "median", "90 %", "most")
    rows = [_row(f"{k}, longer side [px]", v) for k, v in stats.box_side_px.items()]
    rows.append(_row("distance [m]", stats.distance_m))
    note = f"Of {stats.cut} boxes under 90 % is to be seen."
    return _table(header, rows) + "\n\n" + note


def _row(what: str, values: Spread | None) -> tuple[object, ...]:
    if values is None:
        return (what, 0, *["-"] * 5)
    v = values
    return (what, v.count, *(f"{x:.3g}" for x in (v.least, v.p10, v.median, v.p90, v.most)))


def _licences(description: Mapping[str, Any]) -> str:
    licences = description.get("licences")
    if not isinstance(licences, dict) or not licences:
        return "Not noted in the data set. (add: who owns the pictures, and what others may do)"
    backgrounds = description.get("backgrounds")
    counts = backgrounds if isinstance(backgrounds, dict) else {}
    rows = [
        (source, licence, len(files) if isinstance(files := counts.get(source), list) else "-")
        for source, licence in licences.items()
    ]
    return _table(("backgrounds from", "licence", "files"), rows)


def _table(header: Sequence[str], rows: Any) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(_plain(cell) for cell in row) + " |" for row in lines)


def _plain(value: object) -> str:
    """A value that breaks no table."""
    return " ".join(str(value).split()).replace("|", "\\|").replace("`", "'")[:500]
