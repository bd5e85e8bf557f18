"""A data set on disk: pictures, one line of labels each, and how it was made."""

from __future__ import annotations

import json
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from detector_training.backgrounds import Background, Split, licence_of
from detector_training.errors import DatasetError, SceneError
from detector_training.scenes.backdrop import Library
from detector_training.scenes.contact_sheet import contact_sheet
from detector_training.scenes.depth import DepthSensor, depth_of, description, png_of
from detector_training.scenes.generator import generate
from detector_training.scenes.recipe import Recipe
from target_pose.target import load_round_target

MAX_COUNT = 1_000_000
IMAGES, DEPTH = "images", "depth"
LABELS = "labels.jsonl"
DESCRIPTION = "dataset.json"
CONTACT_SHEET = "contact_sheet.png"
_SPLIT_SEED = {Split.TRAIN: 1, Split.VAL: 2, Split.TEST: 3}


@dataclass(frozen=True, slots=True)
class DatasetRequest:
    """What to generate.

    Raises:
        SceneError: a number is out of bounds.
    """

    count: int
    seed: int
    split: Split
    target: str
    """Name of a packaged target, or path of a TOML file."""
    backgrounds: tuple[Background, ...]
    """Of this split."""
    recipe: Recipe = Recipe.MIXED
    depth: DepthSensor = DepthSensor.NONE
    """The pictures are the same with it and without."""

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MAX_COUNT:
            raise SceneError(f"--count {self.count}: give 1 to {MAX_COUNT} pictures")
        if not 0 <= self.seed < 2**63:
            raise SceneError(f"--seed {self.seed}: give a whole number from 0 to 2^63 - 1")


@dataclass(frozen=True, slots=True)
class _Worker:
    request: DatasetRequest
    out: Path

    def __call__(self, index: int) -> dict[str, Any]:
        r = self.request
        library = Library.of(r.backgrounds)
        seed = (r.seed, _SPLIT_SEED[r.split], list(Recipe).index(r.recipe), index)
        scene = generate(seed, library, load_round_target(r.target), r.recipe)
        name = f"{index:06d}.jpg"
        (self.out / IMAGES / name).write_bytes(scene.jpeg)
        label = scene.label(f"{IMAGES}/{name}")
        if r.depth is DepthSensor.NONE:
            return label
        path = f"{DEPTH}/{index:06d}.png"
        (self.out / path).write_bytes(png_of(depth_of(seed, scene.geometry)))
        return label | {"depth": path} | scene.view()


def write_dataset(
    out: Path,
    request: DatasetRequest,
    command: str,
    jobs: int = 1,
    overwrite: bool = False,
    on_progress: Callable[[int], None] = lambda done: None,
) -> dict[str, Any]:
    """Generate the pictures and labels into ``out``; the labels appear when all are written.

    Args:
        out: folder, made when missing.
        request: what to generate.
        command: the command line, written into ``dataset.json``.
        jobs: processes.
        overwrite: replace a data set that is there.
        on_progress: called with the number of pictures done.

    Returns:
        The content of ``dataset.json``.

    Raises:
        DatasetError: ``out`` holds a data set already, or cannot be written.
        SceneError: ``jobs`` is out of bounds.
    """
    if not 1 <= jobs <= 256:
        raise SceneError(f"--jobs {jobs}: give 1 to 256 processes")
    _make_room(out, request.depth, overwrite)
    worker = _Worker(request, out)
    labels = []
    with (out / f"{LABELS}.part").open("w", encoding="utf-8") as file:
        for label in _run(worker, request.count, jobs):
            file.write(json.dumps(label) + "\n")
            labels.append(label)
            on_progress(len(labels))
    (out / f"{LABELS}.part").replace(out / LABELS)
    description = _describe(request, command, labels)
    (out / DESCRIPTION).write_text(json.dumps(description, indent=2) + "\n", encoding="utf-8")
    cv2.imwrite(str(out / CONTACT_SHEET), contact_sheet(out, labels))
    return description


def _make_room(out: Path, depth: DepthSensor, overwrite: bool) -> None:
    if not overwrite and ((out / LABELS).exists() or any(_ours(out))):
        raise DatasetError(
            f"{out} holds a data set already, or a part of one; name another folder or --overwrite"
        )
    try:
        (out / IMAGES).mkdir(parents=True, exist_ok=True)
        if depth is not DepthSensor.NONE:
            (out / DEPTH).mkdir(exist_ok=True)
        for old in (*_ours(out), out / LABELS):
            old.unlink(missing_ok=True)
    except OSError as error:
        raise DatasetError(f"cannot write to {out}: {error.strerror}") from None


def _ours(out: Path) -> Iterator[Path]:
    """Pictures by the names that this writer gives; whatever else lies there is the user's."""
    for pattern in (f"{IMAGES}/*.jpg", f"{DEPTH}/*.png"):
        yield from (p for p in out.glob(pattern) if len(p.stem) == 6 and p.stem.isdigit())


def _run(worker: _Worker, count: int, jobs: int) -> Iterator[dict[str, Any]]:
    if jobs == 1:
        yield from map(worker, range(count))
        return
    # spawn: a fork would copy the progress bar's thread and OpenCV's half-made pool
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_one_thread) as pool:
        yield from pool.map(worker, range(count), chunksize=4)


def _one_thread() -> None:
    cv2.setNumThreads(1)


def _describe(
    request: DatasetRequest, command: str, labels: list[dict[str, Any]]
) -> dict[str, Any]:
    kinds = Counter(label["kind"] for label in labels)
    conditions = Counter(c for label in labels for c in label["conditions"])
    recipes = Counter(label["recipe"] for label in labels)
    by_source: dict[str, list[str]] = {}
    for b in request.backgrounds:
        by_source.setdefault(b.source, []).append(b.path.name)
    return {
        "format": "labels.jsonl: one JSON object a picture; boxes circumscribe the true shapes, "
        "unclipped; pixel (0, 0) is the centre of the first pixel",
        "command": command,
        "seed": request.seed,
        "split": str(request.split),
        "recipe": str(request.recipe),
        "target": request.target,
        "depth": None if request.depth is DepthSensor.NONE else description(),
        "count": request.count,
        "kinds": dict(sorted(kinds.items())),
        "recipes": dict(sorted(recipes.items())),
        "conditions": dict(sorted(conditions.items())),
        "licences": {k: licence_of(k) for k in sorted(by_source)},
        "backgrounds": {k: sorted(v) for k, v in sorted(by_source.items())},
    }
