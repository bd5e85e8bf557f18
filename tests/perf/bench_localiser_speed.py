"""Time of ``localise`` beside the markers' libraries: by turns on each pose, on one core."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.perf.bench_detector_prints import APRILTAG, ARUCO, OURS
from tests.perf.bench_localiser_markers import april_tag_poses, aruco_poses, black_side_m
from tests.perf.bench_localiser_poses import CAMERA, accuracy_cells
from tests.perf.bench_localiser_trial import Examiner, Setting, localisers

TAG, TAG_HALF, ARUCO_OPENCV = "AprilTag, full resolution", "AprilTag, its default", "ArUco"
LOCALISE = "localise"
WARM = 3
"""Turns on the first pose that are not counted."""


@dataclass(frozen=True)
class Timed:
    """One contender's times over the poses."""

    name: str
    count: int
    p50_ms: float
    p99_ms: float
    cpu_p50_ms: float
    """Of the processor: what is left of it when others take the core away."""
    ratio: float
    """Median over the poses of the processor's time of ``localise`` over its own on the pose."""
    ratio_low: float
    ratio_high: float
    """Quartiles of that."""


def measure(setting: Setting, count: int) -> list[Timed]:
    """Each contender on ``count`` poses of the accuracy cells, in a process of its own.

    Returns:
        Ours first; nothing where the detector found no target.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(_measure, setting, count).result()


def _measure(setting: Setting, count: int) -> list[Timed]:
    core = min(os.sched_getaffinity(0))
    examiner = Examiner.open(setting, markers=False)
    target = examiner.target
    finders = {
        TAG: (APRILTAG, april_tag_poses(CAMERA.color, black_side_m(APRILTAG, target))),
        TAG_HALF: (APRILTAG, april_tag_poses(CAMERA.color, black_side_m(APRILTAG, target), 2.0)),
        ARUCO_OPENCV: (ARUCO, aruco_poses(CAMERA.color, black_side_m(ARUCO, target))),
    }
    os.sched_setaffinity(0, {core})
    ways = {LOCALISE if name == OURS else name: way for name, way in localisers().items()}
    times: dict[str, list[float]] = {name: [] for name in (*ways, *finders)}
    spent: dict[str, list[float]] = {name: [] for name in times}
    cells = accuracy_cells()
    for k in range(count):
        cell, index = cells[k % len(cells)], k // len(cells)
        view = examiner.album(cell, OURS).view(index)
        candidate = None if view is None else examiner.candidate(view)
        if view is None or candidate is None:
            continue
        seen = (view.color_rgb, view.depth_units, CAMERA, candidate, target, view.up_camera)
        runs = {name: _bound(way, *seen) for name, way in ways.items()}
        for name, (printed, find) in finders.items():
            other = examiner.album(cell, printed).view(index)
            assert other is not None
            runs[name] = _bound(find, other.color_rgb)
        for turn in range(WARM if k == 0 else 0, -1, -1):
            for name, run in runs.items():
                start, cpu = time.perf_counter_ns(), time.process_time_ns()
                run()
                if turn == 0:
                    times[name].append((time.perf_counter_ns() - start) / 1e6)
                    spent[name].append((time.process_time_ns() - cpu) / 1e6)
    if not times[LOCALISE]:
        return []
    return [_timed(name, times[name], spent[name], spent[LOCALISE]) for name in times]


def _bound(run: Callable[..., object], *arguments: Any) -> Callable[[], object]:
    return lambda: run(*arguments)


def _timed(name: str, ms: list[float], cpu_ms: list[float], ours_ms: list[float]) -> Timed:
    ratios = np.array(ours_ms) / np.maximum(cpu_ms, 1e-3)
    low, middle, high = np.quantile(ratios, (0.25, 0.5, 0.75)).tolist()
    p50, p99 = np.percentile(ms, (50, 99)).tolist()
    return Timed(name, len(ms), p50, p99, float(np.median(cpu_ms)), middle, low, high)
