"""How far the localiser's poses are from the truth, whether it knows, and beside others.

    scripts/bench localiser --package-root FOLDER --out docs/results/localiser.md

Poses are rendered for it, with seeds and backgrounds that no training has, and kept in --cache.
Parts: ``accuracy`` per condition and distance, beside AprilTag, ArUco and the paper's PnP;
``occlusion``; ``ladder``, without depth and without a picture; ``real``, a real recording (left out
where it is absent); ``speed`` on one core, after the rest.

Example, two minutes: scripts/bench localiser --count 5 --only accuracy --trials trials.jsonl
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2

import target_pose
from detector_training.backgrounds import advice
from detector_training.commands.shell import one_line_errors
from edge_service.detector.engines import ENGINES, open_engine
from target_pose.target import load_target
from tests.perf import bench_localiser_speed as speed
from tests.perf.bench_detector import positive, progress, shown_command
from tests.perf.bench_detector_prints import OURS
from tests.perf.bench_detector_real import RECORDING
from tests.perf.bench_detector_scenes import generator_version, test_backgrounds
from tests.perf.bench_detector_table import machine
from tests.perf.bench_localiser_markers import ARUCO_IPPE, TAG_IPPE, TAG_OWN
from tests.perf.bench_localiser_pictures import picture_of, plot_calibration
from tests.perf.bench_localiser_poses import (
    ACCURACY,
    Album,
    accuracy_cells,
    occlusion_cells,
)
from tests.perf.bench_localiser_real import measure_real
from tests.perf.bench_localiser_summary import (
    by,
    calibration,
    cell_summary,
    is_assumed_flip,
    is_covered,
    is_flip,
    paired,
)
from tests.perf.bench_localiser_table import report_text
from tests.perf.bench_localiser_trial import (
    PNP,
    Setting,
    Sight,
    Task,
    Trial,
    examine,
    localisers,
    start,
)

PARTS = ("accuracy", "occlusion", "ladder", "real", "speed")
WORST = 40
"""Pictures written, and flips listed."""


def tasks_of(options: argparse.Namespace, parts: Sequence[str]) -> list[Task]:
    """What there is to do with each pose; a nominal one may serve two parts."""
    wanted = options.condition or list(ACCURACY)
    tasks = []
    for cell in accuracy_cells():
        accuracy = options.count if "accuracy" in parts and cell.condition in wanted else 0
        ladder = options.ladder if "ladder" in parts and cell.condition == "nominal" else 0
        for index in range(max(accuracy, ladder)):
            sights = (Sight.ALL,) * (index < accuracy)
            sights += (Sight.NO_DEPTH, Sight.BLACK) * (index < ladder)
            tasks.append(Task(cell, index, sights, index < min(accuracy, options.markers)))
    if "occlusion" in parts:
        tasks += [Task(c, k) for c in occlusion_cells() for k in range(options.occlusion)]
    return tasks


def run_tasks(
    tasks: Sequence[Task], setting: Setting, jobs: int, on_progress: Callable[[int], None]
) -> list[Trial]:
    """All trials, by several processes; in the order of the tasks."""
    markers = any(task.markers for task in tasks)
    trials: list[Trial] = []
    for done, some in enumerate(_examined(tasks, setting, markers, jobs), 1):
        trials += some
        on_progress(done)
    return trials


def _examined(
    tasks: Sequence[Task], setting: Setting, markers: bool, jobs: int
) -> Iterator[list[Trial]]:
    if jobs == 1:
        cv2.setNumThreads(1)
        start(setting, markers)
        yield from map(examine, tasks)
        return
    # spawn: a fork would copy the progress bar's thread and torch's pools
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        jobs, mp_context=context, initializer=start, initargs=(setting, markers)
    ) as pool:
        yield from pool.map(examine, tasks, chunksize=4)


def accuracy_part(trials: Sequence[Trial], others: Sequence[Trial]) -> dict[str, Any]:
    """Cells and calibration of our own way; ``others`` count for the methods' calibration."""
    groups: dict[str, list[Trial]] = {"all": list(trials)}
    groups |= by(trials, lambda t: t.condition)
    groups |= by((t for t in others if t.localised), lambda t: t.condition)
    methods = by((t for t in (*trials, *others) if t.method), lambda t: f"by {t.method}")
    groups |= dict(sorted(methods.items()))
    return {
        "cells": [cell_summary(rows) for rows in by(trials, _cell).values()],
        "calibration": {name: calibration(rows, drawn=True) for name, rows in groups.items()}
        | {"all, camera exactly known": calibration(trials)},
    }


def side_by_side(trials: Sequence[Trial], count: int) -> list[dict[str, Any]]:
    """Ours, the markers' and the paper's, cell by cell, over the first ``count`` poses."""
    rows = []
    for (condition, distance), cell in by(trials, _cell).items():
        ways = by((t for t in cell if t.index < count), lambda t: t.way)
        ours = ways[OURS]
        row: dict[str, Any] = {"condition": condition, "distance_m": distance, "poses": len(ours)}
        row["found"] = {"ours": _found(ours)}
        if TAG_OWN in ways:
            own, ippe = paired(ours, ways[TAG_OWN]), paired(ours, ways[TAG_IPPE])
            for figure in ("position_mm", "normal_deg"):
                own[figure] = min(own[figure], ippe[figure], key=_their_median)
            row["apriltag"], row["found"]["apriltag"] = own, _found(ways[TAG_OWN])
        if ARUCO_IPPE in ways:
            row["aruco"] = paired(ours, ways[ARUCO_IPPE])
            row["found"]["aruco"] = _found(ways[ARUCO_IPPE])
        if PNP in ways:
            row["pnp"], row["found"]["pnp"] = paired(ours, ways[PNP]), _found(ways[PNP])
        rows.append(row)
    return rows


def _found(trials: Sequence[Trial]) -> float:
    """Share with a pose."""
    return sum(t.localised for t in trials) / len(trials)


def _their_median(pair: dict[str, Any]) -> float:
    return float("inf") if pair["theirs"] is None else float(pair["theirs"]["median"])


def _cell(trial: Trial) -> tuple[str, float | None]:
    return trial.condition, trial.distance_m


def occlusion_part(trials: Sequence[Trial], albums: dict[str, Album]) -> dict[str, Any]:
    """Cells, and what is neither refused nor covered, worst first."""
    uncovered = sorted(
        (t for t in trials if not is_covered(t)), key=lambda t: -(t.squared or {})["pose"]
    )
    return {
        "cells": [cell_summary(rows) for rows in by(trials, _cell).values()],
        "localised": sum(t.localised for t in trials),
        "uncovered": [_with_seed(t, albums) for t in uncovered],
    }


def flips_part(trials: Sequence[Trial], albums: dict[str, Album]) -> dict[str, Any]:
    """Of everything that our own way localised."""
    flips = sorted((t for t in trials if is_flip(t)), key=lambda t: -(t.normal_deg or 0.0))
    return {
        "poses": sum(t.localised for t in trials),
        "count": len(flips),
        "assumed": sum(map(is_assumed_flip, trials)),
        "worst": [_with_seed(t, albums) for t in flips[:WORST]],
    }


def _with_seed(trial: Trial, albums: dict[str, Album]) -> dict[str, Any]:
    return trial.plain() | {"seed": list(albums[trial.cell].seed_of(trial.index))}


def write_worst(folder: Path, trials: Sequence[Trial], albums: dict[str, Album]) -> int:
    """Pictures of flips, of what is not covered, and of each cell's farthest miss; their number."""
    folder.mkdir(parents=True, exist_ok=True)
    chosen: dict[tuple[str, str, int], tuple[str, Trial]] = {}
    reasons: list[tuple[str, list[Trial]]] = [
        ("flip", [t for t in trials if is_flip(t)]),
        ("uncovered", [t for t in trials if not is_covered(t)]),
    ]
    for rows in by((t for t in trials if t.localised), _cell).values():
        reasons.append(("position", [max(rows, key=lambda t: t.position_mm or 0.0)]))
        reasons.append(("normal", [max(rows, key=lambda t: t.normal_deg or 0.0)]))
    for why, some in reasons:
        for t in sorted(some, key=lambda t: -(t.squared or {}).get("pose", 0.0))[:WORST]:
            chosen.setdefault((t.condition, t.cell, t.index), (why, t))
    target = load_target()
    for (condition, cell, index), (why, trial) in chosen.items():
        view = albums[cell].view(index)
        if view is None:
            continue
        name = cell if cell.startswith(condition) else f"{condition} {cell}"
        picture = picture_of(trial, view, target, f"{why}: {name}, pose {index}")
        bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        cv2.imwrite(str(folder / f"{why}-{name.replace(' ', '_')}-{index:06d}.png"), bgr)
    return len(chosen)


def localiser_version() -> str:
    """Digest of the localiser's sources."""
    digest = hashlib.sha256()
    for path in sorted(Path(target_pose.__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def run(options: argparse.Namespace) -> dict[str, Any]:
    """All the parts that are asked for, as plain values."""
    parts = options.only or list(PARTS)
    # one thread each, set before the processes start: pools of threads would fight for the cores
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    backgrounds = test_backgrounds(options.package_root, options.backgrounds)
    if line := advice(backgrounds):
        print(line, file=sys.stderr)
    setting = Setting(options.seed, options.cache, backgrounds, options.engine, options.weights)
    detector = open_engine(options.engine, options.weights)
    result: dict[str, Any] = {
        "command": shown_command("localiser", options.arguments),
        "machine": machine(),
        "seed": options.seed,
        "generator": generator_version(),
        "localiser": localiser_version(),
        "detector": detector.describe(),
        "backgrounds": len(backgrounds),
        "counts": {
            "accuracy": options.count,
            "markers": min(options.count, options.markers),
            "occlusion": options.occlusion,
            "ladder": options.ladder,
        },
    }
    if "real" in parts and options.recording.is_dir():
        result["real"] = measure_real(
            detector.detect, load_target(), localisers(), options.recording
        )
    tasks = tasks_of(options, parts)
    if tasks:
        with progress("poses", len(tasks)) as step:
            trials = run_tasks(tasks, setting, options.jobs, step)
        result |= _rendered_parts(options, setting, tasks, trials)
    if "speed" in parts:
        with progress("speed", 1) as step:
            result["speed"] = [asdict(t) for t in speed.measure(setting, options.speed_poses)]
            step(1)
    return result


def _rendered_parts(
    options: argparse.Namespace, setting: Setting, tasks: Sequence[Task], trials: list[Trial]
) -> dict[str, Any]:
    albums = {
        task.cell.name: Album(task.cell, OURS, setting.seed, setting.backgrounds, setting.cache)
        for task in tasks
    }
    accurate = [t for t in trials if t.condition in ACCURACY]
    ladder = [t for t in trials if t.condition in (Sight.NO_DEPTH, Sight.BLACK)]
    occluded = [t for t in trials if t.condition not in {*ACCURACY, Sight.NO_DEPTH, Sight.BLACK}]
    mine = [t for t in trials if t.way == OURS]

    def own(some: list[Trial]) -> list[Trial]:
        return [t for t in some if t.way == OURS]

    result: dict[str, Any] = {}
    if accurate:
        result["accuracy"] = accuracy_part(own(accurate), own(ladder))
        result["side_by_side"] = side_by_side(accurate, options.markers)
    if occluded:
        result["occlusion"] = occlusion_part(own(occluded), albums)
    if ladder:
        cells = [cell_summary(rows) for rows in by(own(ladder), _cell).values()]
        result["ladder"] = {"cells": sorted(cells, key=lambda c: c["condition"])}
    result["flips"] = flips_part(mine, albums)
    if options.trials is not None:
        lines = "".join(json.dumps(t.plain()) + "\n" for t in trials)
        _write(options.trials, lines)
    if options.plot is not None:
        groups = {"all": own(accurate), **by(own(accurate), lambda t: t.condition)}
        plot_calibration(groups | by(own(ladder), lambda t: t.condition), options.plot)
    if options.worst is not None:
        result["worst_pictures"] = write_worst(options.worst, mine, albums)
    return result


def parse(arguments: list[str]) -> argparse.Namespace:
    """The options."""
    p = argparse.ArgumentParser(
        prog="scripts/bench localiser",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    few = "(100, or --count where that is less)"
    p.add_argument("--only", choices=PARTS, action="append", help="this part; repeatable")
    p.add_argument("--condition", choices=ACCURACY, action="append", help="of accuracy; repeatable")
    p.add_argument("--count", type=positive, default=334, help="poses a cell (334: 5010 in all)")
    p.add_argument("--markers", type=positive, help=f"of these beside AprilTag and ArUco {few}")
    p.add_argument("--occlusion", type=positive, help=f"poses a case {few}")
    p.add_argument("--ladder", type=positive, help=f"poses a distance {few}")
    p.add_argument("--speed-poses", type=positive, default=150, help="timed (150)")
    p.add_argument("--weights", type=Path, help="default: the packaged ones")
    p.add_argument("--engine", choices=ENGINES, default="torch")
    p.add_argument("--seed", type=int, default=2026, help="of the poses (2026)")
    p.add_argument("--package-root", type=Path, default=Path("/"), help="as of `scenes`")
    p.add_argument("--backgrounds", type=Path, action="append", default=[], help="likewise")
    p.add_argument("--recording", type=Path, default=RECORDING, help="the real one's folder")
    p.add_argument("--cache", type=Path, default=Path("runs/bench-localiser"))
    p.add_argument("--jobs", type=positive, default=len(os.sched_getaffinity(0)))
    p.add_argument("--trials", type=Path, help="write one JSON line a trial")
    p.add_argument("--plot", type=Path, help="write the calibration as a picture (.png)")
    p.add_argument("--worst", type=Path, help="write pictures of the worst poses to this folder")
    p.add_argument("--json", action="store_true", help="print JSON instead of the tables")
    p.add_argument("--out", type=Path, help="write the tables to this Markdown file")
    options = p.parse_args(arguments)
    options.arguments = arguments
    for name in ("markers", "occlusion", "ladder"):
        if getattr(options, name) is None:
            setattr(options, name, min(100, options.count))
    return options


def _write(path: Path, text: str) -> None:
    part = path.with_name(path.name + ".part")
    part.write_text(text)
    os.replace(part, path)


def main() -> None:
    """Measure, print, and write what was asked for."""
    options = parse(sys.argv[1:])
    with one_line_errors("stopped; what was rendered is kept"):
        result = run(options)
    text = report_text(result)
    print(json.dumps(result, indent=1) if options.json else text)
    if options.out is not None:
        _write(options.out, text)


if __name__ == "__main__":
    main()
