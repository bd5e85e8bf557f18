"""The localiser on the real recording, with boxes from the real detector, against its truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from target_pose.candidate import Candidate, Detections
from target_pose.nesting import group
from target_pose.target import Target
from tests.perf.bench_localiser_summary import calibration, cell_summary
from tests.perf.bench_localiser_trial import Localise, Trial, judged

KITCHEN = RgbdCamera(
    CameraIntrinsics(640, 480, 585.0, 585.0, 320.0, 240.0),
    CameraIntrinsics(640, 480, 585.0, 585.0, 320.0, 240.0),
    0.0002,
    Pose.identity(),
)
"""The recording's own camera: a structured-light one, depth aligned."""
WHOLE = 0.9


def measure_real(
    detect: Callable[[NDArray[np.uint8]], Detections],
    target: Target,
    ways: dict[str, Localise],
    recording: Path,
) -> dict[str, Any]:
    """Errors over the frames that show at least ``WHOLE`` of the target, by way.

    The world of the recording is not aligned with gravity, so none is given.
    """
    truths = json.loads((recording / "targets.json").read_text())
    colours, depths = (sorted((recording / name).iterdir()) for name in ("rgb", "depth"))
    trials: dict[str, list[Trial]] = {name: [] for name in ways}
    for index, (entry, rgb_file, depth_file) in enumerate(
        zip(truths, colours, depths, strict=True)
    ):
        if entry["visible"] < WHOLE:
            continue
        rgb = np.asarray(cv2.imread(str(rgb_file), cv2.IMREAD_COLOR_RGB), np.uint8)
        depth = np.asarray(cv2.imread(str(depth_file), cv2.IMREAD_UNCHANGED), np.uint16)
        truth = Pose.from_matrix(np.array(entry["camera_from_target"]))
        candidate = _there(group(detect(rgb), target, rgb), entry["boxes_px"])
        for name, way in ways.items():
            blank = Trial("recording", "recording", None, index, name)
            if candidate is not None:
                answer = way(rgb, depth, KITCHEN, candidate, target, None)
                blank = judged(blank, answer, truth)
            trials[name].append(blank)
    return {
        name: cell_summary(rows) | {"calibration": calibration(rows)}
        for name, rows in trials.items()
        if rows
    }


def _there(candidates: tuple[Candidate, ...], boxes_px: dict[str, list[float]]) -> Candidate | None:
    """The best candidate whose centre lies in the true inner box."""
    x0, y0, x1, y1 = boxes_px["T_best"]
    for one in candidates:
        u, v = list(one.boxes.values())[-1].center_px
        if x0 <= u <= x1 and y0 <= v <= y1:
            return one
    return None
