"""What the detector sees, what it does not, beside AprilTag and ArUco, and how long it takes.

    scripts/bench detector --package-root FOLDER --out docs/results/detector.md

Pictures are rendered for it, with seeds and backgrounds that no training has, and kept in --cache.
Parts: ``recall`` per condition and false positives, ``markers`` in the same poses, ``real`` the
recording in ../shared/data (left out where it is absent), ``speed`` of the engines.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from detector_training.backgrounds import Background, advice
from detector_training.commands.shell import one_line_errors
from detector_training.datasets.sample import Sample
from detector_training.errors import EvaluationError
from detector_training.evaluation.intervals import upper_bound, wilson
from detector_training.evaluation.matching import Counting, candidate_outcome, match
from detector_training.evaluation.operating_point import at_false_positive_rate
from detector_training.evaluation.run import Detect, Find, run_detector
from detector_training.scenes.recipe import Recipe
from edge_service.detector.engines import ENGINES, open_engine
from target_pose.target import Target, load_target
from tests.perf.bench_detector_markers import (
    FINDERS,
    centres_of_candidates,
    counted,
    is_found,
)
from tests.perf.bench_detector_prints import BLANK, OURS
from tests.perf.bench_detector_real import RECORDING, measure_real
from tests.perf.bench_detector_scenes import (
    SceneSet,
    generator_version,
    rendered,
    test_backgrounds,
)
from tests.perf.bench_detector_speed import measure
from tests.perf.bench_detector_table import machine, report_text

PARTS = ("recall", "markers", "real", "speed")
PAPER = (
    Recipe.BLUR,
    Recipe.LOW_LIGHT,
    Recipe.OBSTRUCTION,
    Recipe.DISTORTION,
    Recipe.FAR,
    Recipe.ORIENTATION,
    Recipe.FLARE,
    Recipe.CLOSE,
)
"""The eight conditions of the paper's Table I."""
MORE = (Recipe.OVER_EXPOSED, Recipe.GLOSSY, Recipe.SCRATCHED)


@dataclass
class Pictures:
    """The rendered sets and what our detector found in them; each is made and looked at once."""

    options: argparse.Namespace
    backgrounds: tuple[Background, ...]
    detect: Detect
    target: Target
    kept: dict[tuple[Recipe, str], tuple[Find, ...]] = field(default_factory=dict)

    def samples(self, recipe: Recipe, printed: str = OURS) -> tuple[Sample, ...]:
        """The pictures of a recipe."""
        o = self.options
        count = o.negatives if recipe is Recipe.HARD_NEGATIVES else o.count
        scenes = SceneSet(recipe, printed, o.seed, count)
        with progress(f"render {recipe} {printed}", count) as step:
            return rendered(scenes, o.cache, self.backgrounds, o.jobs, step)

    def finds(self, recipe: Recipe, printed: str = OURS) -> tuple[Find, ...]:
        """What our detector says of them."""
        if (recipe, printed) not in self.kept:
            samples = self.samples(recipe, printed)
            with progress(f"detect {recipe} {printed}", len(samples)) as step:
                self.kept[recipe, printed] = run_detector(self.detect, samples, self.target, step)
        return self.kept[recipe, printed]


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal; nothing elsewhere."""
    columns = (TextColumn("{task.description:32}"), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    with Progress(
        *columns, TimeRemainingColumn(), console=console, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def recall_part(pictures: Pictures, counting: Counting) -> dict[str, Any]:
    """Recall per condition, false positives, and recall at a false positive rate, nominal."""
    conditions = {}
    for recipe in (Recipe.NOMINAL, *PAPER, *MORE):
        outcomes = [
            candidate_outcome(f.sample, f.candidates, counting) for f in pictures.finds(recipe)
        ]
        hits = truths = false = 0
        for outcome in outcomes:
            hit, ignored, _ = match(outcome)
            hits, truths = hits + int(hit.sum()), truths + int(outcome.counts.sum())
            false += int((~hit & ~ignored).sum())
        recall = wilson(hits, truths)
        conditions[str(recipe)] = {
            "pictures": len(outcomes),
            "truths": truths,
            "recall": recall and recall._asdict(),
            "false_positives": false,
        }
    negatives = {}
    searched = [
        candidate_outcome(f.sample, f.candidates, counting) for f in pictures.finds(Recipe.NOMINAL)
    ]
    nominal = list(searched)
    for name, key in (
        ("hard negatives", (Recipe.HARD_NEGATIVES, OURS)),
        ("blank boards", (Recipe.NOMINAL, BLANK)),
    ):
        # a blank board is labelled as the target that it stands for: nothing is true there
        finds = [without_truth(f) for f in pictures.finds(*key)]
        with_false = sum(bool(f.candidates) for f in finds)
        share = wilson(with_false, len(finds))
        negatives[name] = {
            "pictures": len(finds),
            "with_false": with_false,
            "share": share and share._asdict(),
            "upper_bound_per_1000": 1000 * upper_bound(with_false, len(finds)),
        }
        searched += [candidate_outcome(f.sample, f.candidates, counting) for f in finds]
    point = asdict(at_false_positive_rate(nominal, searched, pictures.options.fp_per_1000))
    point["recall"] = point["recall"] and point["recall"]._asdict()
    return {"operating_point": point, "conditions": conditions, "negatives": negatives}


def without_truth(find: Find) -> Find:
    """The same picture as a negative."""
    s = find.sample
    empty = Sample(
        s.image, s.width, s.height, "negative", s.conditions, s.boxes[:0], s.classes[:0],
        s.visible[:0],
    )  # fmt: skip
    return Find(empty, find.detections, find.candidates)


def markers_part(pictures: Pictures, counting: Counting) -> dict[str, Any]:
    """Our target and the markers, side by side in each condition."""
    finders = {name: make() for name, make in FINDERS.items()}
    rows: dict[str, Any] = {}
    for recipe in (Recipe.NOMINAL, *PAPER, *MORE):
        ours = pictures.finds(recipe)
        wanted = counted([f.sample for f in ours], counting)
        row = {OURS: sum(is_found(ours[k].sample, centres_of_candidates(ours[k])) for k in wanted)}
        for name, find in finders.items():
            samples = pictures.samples(recipe, name)
            for k in wanted:
                if abs(samples[k].boxes - ours[k].sample.boxes).max() > 1e-3:
                    raise EvaluationError(f"{samples[k].image}: not the pose of our target's")
            with progress(f"{name} {recipe}", len(wanted)) as step:
                found = 0
                for done, k in enumerate(wanted, 1):
                    found += is_found(samples[k], find(samples[k].read()))
                    step(done)
            row[name] = found
        shares = {name: wilson(hits, len(wanted)) for name, hits in row.items()}
        rows[str(recipe)] = {
            "truths": len(wanted),
            "recall": {name: share and share._asdict() for name, share in shares.items()},
        }
    return rows


def real_part(detect: Detect, target: Target) -> dict[str, Any] | None:
    """The real recording; None where it is absent."""
    if not RECORDING.is_dir():
        return None
    real = measure_real(detect, target)
    plain = asdict(real)
    for name in ("recall", "ghost_rate"):
        plain[name] = plain[name] and plain[name]._asdict()
    return plain


def speed_part(options: argparse.Namespace) -> dict[str, Any]:
    """The engines by turns, each in its own process."""
    with progress("speed, rounds", options.rounds) as step:
        rows, failed = measure(
            ENGINES, options.weights, options.rounds, options.pictures_a_round, step
        )
    return {
        "rows": [asdict(r) for r in rows],
        "failed": failed,
        "rounds": options.rounds,
        "pictures_a_round": options.pictures_a_round,
    }


def run(options: argparse.Namespace) -> dict[str, Any]:
    """All the parts that are asked for, as plain values."""
    parts = options.only or list(PARTS)
    counting = Counting(options.min_px, options.min_visible)
    result: dict[str, Any] = {
        "command": shown_command("detector", options.arguments),
        "machine": machine(),
        "seed": options.seed,
        "generator": generator_version(),
        "counting": asdict(counting),
    }
    if "speed" in parts:  # first: nothing else runs in this process yet
        result["speed"] = speed_part(options)
    if set(parts) & {"recall", "markers", "real"}:
        detector = open_engine(options.engine, options.weights)
        result["detector"] = detector.describe()
        target = load_target()
        if "real" in parts:
            result["real"] = real_part(detector.detect, target)
        if set(parts) & {"recall", "markers"}:
            backgrounds = test_backgrounds(options.package_root, options.backgrounds)
            if line := advice(backgrounds):
                print(line, file=sys.stderr)
            result["backgrounds"] = len(backgrounds)
            pictures = Pictures(options, backgrounds, detector.detect, target)
            if "recall" in parts:
                result["recall"] = recall_part(pictures, counting)
            if "markers" in parts:
                result["markers"] = markers_part(pictures, counting)
    return result


def shown_command(bench: str, arguments: list[str]) -> str:
    """How it was started; of whole paths the last part alone, the rest is this machine's."""
    shown = [Path(a).name if a.startswith("/") and len(a) > 1 else a for a in arguments]
    return shlex.join(["scripts/bench", bench, *shown])


def parse(arguments: list[str]) -> argparse.Namespace:
    """The options."""
    p = argparse.ArgumentParser(
        prog="scripts/bench detector",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("--only", choices=PARTS, action="append", help="this part; repeatable")
    p.add_argument("--weights", type=Path, help="default: the packaged ones")
    p.add_argument("--engine", choices=ENGINES, default="torch", help="for all but speed")
    p.add_argument("--count", type=positive, default=300, help="pictures a condition (300)")
    p.add_argument("--negatives", type=positive, default=2000, help="hard negatives (2000)")
    p.add_argument("--seed", type=int, default=2026, help="of the pictures (2026)")
    p.add_argument("--fp-per-1000", type=float, default=1.0, help="allowed false positives (1)")
    p.add_argument("--min-px", type=float, default=Counting().min_px, help="narrowest board (14)")
    p.add_argument("--min-visible", type=float, default=Counting().min_visible)
    p.add_argument("--package-root", type=Path, default=Path("/"), help="as of `scenes`")
    p.add_argument("--backgrounds", type=Path, action="append", default=[], help="likewise")
    p.add_argument("--cache", type=Path, default=Path("runs/bench-detector"))
    p.add_argument("--jobs", type=positive, default=len(os.sched_getaffinity(0)))
    p.add_argument("--rounds", type=positive, default=10, help="turns of each engine (10)")
    p.add_argument("--pictures-a-round", type=positive, default=30, help="of a turn (30)")
    p.add_argument("--json", action="store_true", help="print JSON instead of the tables")
    p.add_argument("--out", type=Path, help="write the tables to this Markdown file")
    options = p.parse_args(arguments)
    options.arguments = arguments
    return options


def positive(text: str) -> int:
    """A whole number of at least one, for argparse."""
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{value}: give 1 or more")
    return value


def main() -> None:
    """Measure, print, and write what was asked for."""
    options = parse(sys.argv[1:])
    with one_line_errors("stopped; what was rendered is kept"):
        result = run(options)
    text = report_text(result)
    print(json.dumps(result, indent=1) if options.json else text)
    if options.out is not None:
        part = options.out.with_name(options.out.name + ".part")
        part.write_text(text)
        os.replace(part, options.out)


if __name__ == "__main__":
    main()
