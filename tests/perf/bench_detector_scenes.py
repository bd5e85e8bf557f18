"""The pictures of the detector's bench: rendered once and kept.

A folder of the cache is keyed by recipe, seed, print, backgrounds and the generator's sources; a
larger count goes on where a smaller one ended. The streams of chance are this bench's own: no data
set of ``detector_training scenes`` shares one, whatever its seed.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2

import detector_training
from detector_training.backgrounds import Background, Split, find_backgrounds, of_split
from detector_training.datasets.sample import Sample, load_dataset
from detector_training.scenes import Library, generate
from detector_training.scenes.recipe import Recipe
from target_pose.target import DEFAULT_TARGET, load_target
from tests.perf.bench_detector_prints import PRINTS

STREAM = 4
"""Where data sets have 1 to 3 for their split."""
NOT_IN_PICTURES = ("contact_sheet", "dataset_writer", "flight", "recording", "tunnel")
"""Modules beside the generator that no picture here depends on."""


@dataclass(frozen=True)
class SceneSet:
    """Pictures of one recipe with one print on the board."""

    recipe: Recipe
    printed: str
    """A name of ``PRINTS``."""
    seed: int
    count: int


@dataclass(frozen=True)
class Worker:
    """Renders one picture and its label, in a process of its own."""

    scenes: SceneSet
    folder: Path
    backgrounds: tuple[Background, ...]

    def __call__(self, index: int) -> None:
        """The label appears when the picture is whole."""
        name = f"{index:06d}"
        label = self.folder / "labels" / f"{name}.json"
        if label.exists():
            return
        s = self.scenes
        seed = (s.seed, STREAM, list(Recipe).index(s.recipe), index)
        library, target = Library.of(self.backgrounds), load_target(DEFAULT_TARGET)
        scene = generate(seed, library, target, s.recipe, PRINTS[s.printed])
        (self.folder / "images" / f"{name}.jpg").write_bytes(scene.jpeg)
        part = label.with_suffix(".part")
        part.write_text(json.dumps(scene.label(f"images/{name}.jpg")))
        os.replace(part, label)


def test_backgrounds(package_root: Path, own: Sequence[Path]) -> tuple[Background, ...]:
    """The backgrounds that no training and no validation ever has."""
    return of_split(find_backgrounds(tuple(own), package_root), Split.TEST)


def rendered(
    scenes: SceneSet,
    cache: Path,
    backgrounds: tuple[Background, ...],
    jobs: int,
    on_progress: Callable[[int], None] = lambda done: None,
) -> tuple[Sample, ...]:
    """The pictures of a set, from the cache or rendered into it.

    Args:
        scenes: Which.
        cache: Folder, made when missing.
        backgrounds: What may stand behind the target.
        jobs: Processes.
        on_progress: Called with the number of pictures that are there.
    """
    folder = cache / f"{scenes.recipe}-{scenes.printed}-{_key(scenes, backgrounds)}"
    for name in ("images", "labels"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    worker = Worker(scenes, folder, backgrounds)
    for done, _ in enumerate(work_through(worker, scenes.count, jobs), 1):
        on_progress(done)
    lines = [(folder / f"labels/{k:06d}.json").read_text() + "\n" for k in range(scenes.count)]
    part = folder / "labels.jsonl.part"
    part.write_text("".join(lines))
    os.replace(part, folder / "labels.jsonl")
    return load_dataset(folder)


def generator_version() -> str:
    """Digest of the sources that make the pictures."""
    root = Path(detector_training.__file__).parent
    scenes = sorted(p for p in (root / "scenes").glob("*.py") if p.stem not in NOT_IN_PICTURES)
    sources = [root / "backgrounds.py", *scenes]
    sources.append(Path(__file__).with_name("bench_detector_prints.py"))
    digest = hashlib.sha256()
    for path in sources:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _key(scenes: SceneSet, backgrounds: tuple[Background, ...]) -> str:
    names = sorted(f"{b.source}/{b.path.name}" for b in backgrounds)
    parts = [generator_version(), str(scenes.seed), printed_shape(), *names]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def printed_shape() -> str:
    """What of the target's file the pictures and their labels show."""
    t = load_target(DEFAULT_TARGET)
    return repr((t.board_side_m, t.board_shade, t.discs, t.level_m))


class PictureWorker(Protocol):
    """Makes the picture of a number in ``folder``, unless it is there."""

    folder: Path

    def __call__(self, index: int) -> None:
        """Make it."""
        ...


def work_through(worker: PictureWorker, count: int, jobs: int) -> Iterator[None]:
    """All pictures in turn, by several processes where that is worth their start."""
    missing = sum(not (worker.folder / f"labels/{k:06d}.json").exists() for k in range(count))
    if jobs == 1 or missing < 2 * jobs:
        yield from map(worker, range(count))
        return
    # spawn: a fork would copy the progress bar's thread and OpenCV's half-made pool
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_one_thread) as pool:
        yield from pool.map(worker, range(count), chunksize=4)


def _one_thread() -> None:
    cv2.setNumThreads(1)
