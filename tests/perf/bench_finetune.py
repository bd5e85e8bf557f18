"""What 30 pictures of one's own site are worth: fine-tuning the shipped weights on an odd one.

    scripts/bench finetune --package-root FOLDER

The site: a few backgrounds that training never had, one bad condition throughout, and a print that
the sun has faded to yellow and violet. 30 pictures of it are trained on, with and without general
scenes mixed in; other pictures of the site tell what was gained, general ones what was forgotten.
Pictures and runs are kept in --work, and a second call goes on there.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detector_training.backgrounds import Background, Kind, Split, find_backgrounds, of_split
from detector_training.commands.shell import one_line_errors
from detector_training.datasets.sample import Sample, load_dataset
from detector_training.evaluation.intervals import Interval, wilson
from detector_training.evaluation.matching import Counting, candidate_outcome, match
from detector_training.evaluation.run import Find, run_detector
from detector_training.scenes import Library, generate
from detector_training.scenes.printed import Paint, draw_target
from detector_training.scenes.recipe import Recipe
from detector_training.training import settings as defaults
from detector_training.training.loop import CHECKPOINT, Sets, TrainSettings, train
from detector_training.training.validation import detector_of
from edge_service.detector.files import DEFAULT_WEIGHTS
from edge_service.detector.weights import load_weights
from target_pose.target import DEFAULT_TARGET, load_target
from tests.perf.bench_detector import progress
from tests.perf.bench_detector_scenes import work_through

STREAM = 5
"""Of chance; data sets have 1 to 3 for their split, the detector's bench 4."""
SITE_TRAIN, SITE_TEST, GENERAL_TRAIN, GENERAL_TEST = range(4)
FADED = {"white": (1.0, 0.9, 0.62), "black": (0.42, 0.3, 0.45)}
"""What the sun left of paper and ink, as shares of fresh paper."""


@dataclass(frozen=True)
class Faded:
    """Draws the target in the paints that the sun left."""

    def __call__(self, side_px: int, paint: Paint) -> NDArray[np.float32]:
        """Albedo (side_px, side_px, 3)."""
        white, black = (
            (paint.white * np.array(FADED[name], np.float32)).astype(np.float32)
            for name in ("white", "black")
        )
        return draw_target(load_target(DEFAULT_TARGET), side_px, Paint(white, black))


@dataclass(frozen=True)
class Place:
    """Where pictures are taken."""

    number: int
    """Of the stream of chance."""
    recipe: Recipe
    backgrounds: tuple[Background, ...]
    faded: bool
    seed: int


@dataclass(frozen=True)
class Worker:
    """Renders one picture and its label, in a process of its own."""

    place: Place
    folder: Path

    def __call__(self, index: int) -> None:
        """The label appears when the picture is whole."""
        label = self.folder / "labels" / f"{index:06d}.json"
        if label.exists():
            return
        p = self.place
        seed = (p.seed, STREAM, p.number, index)
        library = Library.of(p.backgrounds)
        board = Faded() if p.faded else None
        scene = generate(seed, library, load_target(DEFAULT_TARGET), p.recipe, board)
        (self.folder / "images" / f"{index:06d}.jpg").write_bytes(scene.jpeg)
        part = label.with_suffix(".part")
        part.write_text(json.dumps(scene.label(f"images/{index:06d}.jpg")))
        os.replace(part, label)


@dataclass(frozen=True)
class Measured:
    """How many targets a detector found, and what else."""

    recall: Interval | None
    false_positives: int
    pictures: int
    hits: tuple[bool, ...]
    """Of each target that counts, in order: to tell what was gained from what was lost."""

    def as_json(self) -> dict[str, Any]:
        """Without the single targets."""
        plain = asdict(self)
        del plain["hits"]
        plain["recall"] = self.recall and self.recall._asdict()
        return plain


def rendered(place: Place, folder: Path, count: int, jobs: int) -> tuple[Sample, ...]:
    """Pictures of a place, kept in a folder."""
    for name in ("images", "labels"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    with progress(f"render {folder.name}", count) as step:
        for done, _ in enumerate(work_through(Worker(place, folder), count, jobs), 1):
            step(done)
    lines = [(folder / f"labels/{k:06d}.json").read_text() + "\n" for k in range(count)]
    (folder / "labels.jsonl").write_text("".join(lines))
    return load_dataset(folder)


def measured(finds: Sequence[Find]) -> Measured:
    """Whole targets after the nesting check, at the service's threshold."""
    hits: list[bool] = []
    false = 0
    for find in finds:
        outcome = candidate_outcome(find.sample, find.candidates, Counting())
        hit, ignored, taken = match(outcome)
        false += int((~hit & ~ignored).sum())
        hits += [m in taken for m in np.flatnonzero(outcome.counts).tolist()]
    return Measured(wilson(sum(hits), len(hits)), false, len(finds), tuple(hits))


def measure(weights: Path, sets: dict[str, tuple[Sample, ...]], name: str) -> dict[str, Measured]:
    """What the detector with these weights says of the pictures of each set."""
    detect, target = detector_of(load_weights(weights)[0]).detect, load_target(DEFAULT_TARGET)
    found = {}
    for what, samples in sets.items():
        with progress(f"detect {name}, {what}", len(samples)) as step:
            found[what] = measured(run_detector(detect, samples, target, step))
    return found


def tune(
    options: argparse.Namespace, run: Path, site: tuple[Sample, ...], mixed: tuple[Sample, ...]
) -> Path:
    """Fine-tune as ``train --from`` does by default; a run that stands is gone on with."""
    net, info = load_weights(options.weights)
    settings = TrainSettings(
        pictures=options.pictures,
        seed=options.seed,
        width=net.config.width,
        learning_rate=options.learning_rate,
        warm_up_steps=defaults.FINE_TUNE_WARM_UP_STEPS,
        keep_norms=not options.learn_norms,
        mix_share=defaults.MIX_SHARE if mixed else 0.0,
        target=info.target,
        workers=options.jobs,
    )
    resume = (run / CHECKPOINT).exists()
    with progress(f"train {run.name}", options.pictures) as step:
        return train(
            site,
            run,
            settings,
            sets=Sets(net, mixed),
            resume=resume,
            report=lambda p: step(p.images),
        )


def run(options: argparse.Namespace) -> dict[str, Any]:
    """The experiment."""
    found = find_backgrounds(tuple(options.backgrounds), options.package_root)
    test = of_split(found, Split.TEST)
    rng = np.random.default_rng((options.seed, STREAM))
    photos = [b for b in test if b.kind is Kind.PHOTO]
    picked = rng.permutation(len(photos))[: options.site_backgrounds].tolist()
    few = tuple(photos[i] for i in picked)
    others = tuple(b for b in test if b not in few)
    seed, recipe = options.seed, Recipe(options.recipe)
    count = {
        "site-train": (Place(SITE_TRAIN, recipe, few, True, seed), options.own),
        "site-test": (Place(SITE_TEST, recipe, few, True, seed), options.count),
        "general-train": (
            Place(GENERAL_TRAIN, Recipe.MIXED, of_split(found, Split.TRAIN), False, seed),
            options.mixed,
        ),
        "general-test": (Place(GENERAL_TEST, Recipe.MIXED, others, False, seed), options.count),
    }
    sets = {
        name: rendered(place, options.work / f"{name}-{recipe}-{seed}", n, options.jobs)
        for name, (place, n) in count.items()
    }
    weights = {"shipped": options.weights}
    for name, mixed in (("tuned, mixed", sets["general-train"]), ("tuned alone", ())):
        folder = options.work / f"{name.replace(', ', '-').replace(' ', '-')}-{recipe}-{seed}"
        weights[name] = tune(options, folder, sets["site-train"], mixed)
    tested = {what: sets[what] for what in ("site-test", "general-test")}
    rows = {name: measure(path, tested, name) for name, path in weights.items()}
    return {
        "recipe": str(recipe),
        "own_pictures": options.own,
        "pictures_seen": options.pictures,
        "site_backgrounds": len(few),
        "rows": rows,
    }


def table(result: dict[str, Any]) -> str:
    """For people."""
    lines = [
        f"fine-tuning on {result['own_pictures']} pictures of a site ({result['recipe']}, "
        f"{result['site_backgrounds']} backgrounds, faded print), "
        f"{result['pictures_seen']} pictures seen",
        "",
        "| weights | pictures | recall (95 %) | gained / lost | false positives |",
        "| --- | --- | --- | --- | --- |",
    ]
    first = result["rows"]["shipped"]
    for name, row in result["rows"].items():
        for what, m in row.items():
            r = m.recall
            recall = "-" if r is None else f"{r.value:.3f} ({r.low:.3f}-{r.high:.3f})"
            pairs = list(zip(first[what].hits, m.hits, strict=True))
            gained, lost = pairs.count((False, True)), pairs.count((True, False))
            false = f"{m.false_positives} in {m.pictures}"
            lines.append(f"| {name} | {what} | {recall} | {gained} / {lost} | {false} |")
    return "\n".join(lines)


def parse(arguments: list[str]) -> argparse.Namespace:
    """The options."""
    p = argparse.ArgumentParser(
        prog="scripts/bench finetune",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("--weights", type=Path, default=DEFAULT_WEIGHTS, help="default: shipped")
    p.add_argument("--recipe", choices=list(Recipe), default=Recipe.LOW_LIGHT, help="of the site")
    p.add_argument("--site-backgrounds", type=int, default=3, help="photographs of the site (3)")
    p.add_argument("--own", type=int, default=30, help="pictures to tune on (30)")
    p.add_argument("--mixed", type=int, default=300, help="general pictures to mix in (300)")
    p.add_argument("--count", type=int, default=300, help="pictures of each test (300)")
    p.add_argument("--pictures", type=int, default=2000, help="seen in each tuning (2000)")
    p.add_argument("--learning-rate", type=float, default=defaults.FINE_TUNE_LEARNING_RATE)
    p.add_argument("--learn-norms", action="store_true", help="not the statistics of the weights")
    p.add_argument("--seed", type=int, default=2026)
    p.add_argument("--package-root", type=Path, default=Path("/"), help="as of `scenes`")
    p.add_argument("--backgrounds", type=Path, action="append", default=[], help="likewise")
    p.add_argument("--work", type=Path, default=Path("runs/bench-finetune"))
    p.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    p.add_argument("--json", action="store_true", help="print JSON instead of the table")
    return p.parse_args(arguments)


def main() -> None:
    """Measure and print."""
    options = parse(sys.argv[1:])
    with one_line_errors("stopped; the same call goes on"):
        result = run(options)
    if options.json:
        rows = {n: {w: m.as_json() for w, m in row.items()} for n, row in result["rows"].items()}
        print(json.dumps(result | {"rows": rows}, indent=1))
    else:
        print(table(result))


if __name__ == "__main__":
    main()
