"""The real recording: found where the target is to be seen, not where it is painted over."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.sample import CLASSES, Sample
from detector_training.evaluation.intervals import Interval, wilson
from detector_training.evaluation.matching import Counting, candidate_outcome, match
from detector_training.evaluation.run import Detect
from target_pose.nesting import group
from target_pose.target import Target

RECORDING = Path(__file__).parents[3] / "shared/data/kitchen-bullseye"
WHOLE = 0.9
PAINT_MARGIN_PX = 8


@dataclass(frozen=True)
class Real:
    """What was found in the recording."""

    frames: int
    whole: int
    """Frames that show at least ``WHOLE`` of the target."""
    found: int
    """Of these."""
    recall: Interval | None
    missed: tuple[str, ...]
    ghosts: int
    """Frames with a false target, beside the true one or where it is painted over."""
    ghost_rate: Interval | None


def measure_real(detect: Detect, target: Target, recording: Path = RECORDING) -> Real:
    """Look at each frame, as it is and with the target painted over."""
    truths = json.loads((recording / "targets.json").read_text())
    pictures = sorted((recording / "rgb").iterdir())
    whole = found = ghosts = 0
    missed = []
    for entry, path in zip(truths, pictures, strict=True):
        rgb = np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR_RGB), np.uint8)
        sample = _sample(path, rgb, entry)
        outcome = candidate_outcome(sample, group(detect(rgb), target, rgb), Counting())
        hit, ignored, _ = match(outcome)
        if entry["visible"] >= WHOLE:
            whole += 1
            found += bool(hit.any())
            if not hit.any():
                missed.append(path.name)
        bare = painted_over(rgb, entry["boxes_px"]["T_good"])
        ghosts += bool((~hit & ~ignored).any()) or bool(group(detect(bare), target, bare))
    n = len(truths)
    rate = wilson(ghosts, n)
    return Real(n, whole, found, wilson(found, whole), tuple(missed), ghosts, rate)


def painted_over(rgb: NDArray[np.uint8], box: list[float]) -> NDArray[np.uint8]:
    """The picture without its target: inpainted from around it."""
    x0, y0, x1, y1 = (round(v) for v in box)
    cover = np.zeros(rgb.shape[:2], np.uint8)
    m = PAINT_MARGIN_PX
    cover[max(0, y0 - m) : max(0, y1 + m), max(0, x0 - m) : max(0, x1 + m)] = 1
    return np.asarray(cv2.inpaint(rgb, cover, 3, cv2.INPAINT_TELEA), np.uint8)


def _sample(path: Path, rgb: NDArray[np.uint8], entry: dict) -> Sample:
    levels = list(entry["boxes_px"])
    return Sample(
        path,
        rgb.shape[1],
        rgb.shape[0],
        "scene",
        (),
        np.array([entry["boxes_px"][name] for name in levels], np.float32),
        np.array([CLASSES.index(name) for name in levels], np.int64),
        np.full(len(levels), entry["visible"], np.float32),
    )
