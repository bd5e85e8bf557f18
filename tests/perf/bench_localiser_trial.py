"""One pose of the bench in one process: render it, detect, localise in every way, compare."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.backgrounds import Background
from edge_service.detector.engines import open_engine
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.geometry import Pose
from target_pose.candidate import Candidate, Detections
from target_pose.covariance import BEARING_SIGMA_RAD
from target_pose.fusion import SIZE_SIGMA
from target_pose.localisation import Localisation, Refusal
from target_pose.localise import localise
from target_pose.nesting import group
from target_pose.target import Target, load_target
from tests.perf.bench_detector_markers import TOLERANCE
from tests.perf.bench_detector_prints import OURS
from tests.perf.bench_localiser_errors import pose_error, squared_mahalanobis
from tests.perf.bench_localiser_markers import WAYS, FindPoses, open_markers
from tests.perf.bench_localiser_poses import CAMERA, Album, Cell, View

Localise: TypeAlias = Callable[
    [
        NDArray[np.uint8],
        NDArray[np.uint16] | None,
        RgbdCamera,
        Candidate,
        Target,
        NDArray[np.float64] | None,
    ],
    Localisation | Refusal,
]
PNP = "pnp"
BLACK_LEVEL = 4
"""Grey values of a black picture's noise lie under this."""


class Sight(StrEnum):
    """What of a frame the localiser gets; the boxes are always those of the lit picture."""

    ALL = "all"
    NO_DEPTH = "no depth"
    BLACK = "black picture"


@dataclass(frozen=True)
class Trial:
    """What one way made of one pose."""

    cell: str
    condition: str
    """Of the cell, or the sight where that is not all."""
    distance_m: float | None
    index: int
    way: str
    """A print of ours or of the markers' ``WAYS``, or ``pnp``."""
    found: bool = False
    """By its detector, where it truly is."""
    refusal: str | None = None
    method: str | None = None
    ambiguous: bool = False
    roll_source: str | None = None
    tilt_deg: float = 0.0
    position_mm: float | None = None
    normal_deg: float | None = None
    roll_deg: float | None = None
    squared: dict[str, float] | None = None
    """Squared Mahalanobis errors by ``DEGREES_OF_FREEDOM``."""
    squared_drawn: dict[str, float] | None = None
    """The same with a camera whose calibration is off, as the covariance believes it is."""
    estimate: list[float] | None = None
    """``camera_from_target``: translation, then q_wxyz."""

    @property
    def localised(self) -> bool:
        """There is a pose."""
        return self.position_mm is not None

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


@dataclass(frozen=True)
class Task:
    """What to do with one pose of a cell."""

    cell: Cell
    index: int
    sights: tuple[Sight, ...] = (Sight.ALL,)
    markers: bool = False
    """The same pose with the markers' prints as well."""


@dataclass(frozen=True)
class Setting:
    """What a process needs for its tasks."""

    seed: int
    cache: Path
    backgrounds: tuple[Background, ...]
    engine: str
    weights: Path | None


@dataclass(frozen=True, eq=False)
class Examiner:
    """All that looks at pictures, in one process."""

    setting: Setting
    detect: Callable[[NDArray[np.uint8]], Detections]
    target: Target
    ways: dict[str, Localise]
    markers: dict[str, FindPoses]

    @classmethod
    def open(cls, setting: Setting, markers: bool) -> Examiner:
        """Load the net and the libraries; one thread each."""
        cv2.setNumThreads(1)
        detector = open_engine(setting.engine, setting.weights, threads=1)
        target = load_target()
        found = open_markers(CAMERA.color, target) if markers else {}
        return cls(setting, detector.detect, target, localisers(), found)

    def examine(self, task: Task) -> list[Trial]:
        """All trials of one pose; none where nothing of the board is in the picture."""
        view = self.album(task.cell, OURS).view(task.index)
        if view is None:
            return []
        candidate = self.candidate(view)
        trials = []
        for sight in task.sights:
            seen = with_sight(view, sight, self.setting.seed + task.index)
            for name, way in self.ways.items():
                blank = _blank(task, view, name, sight)
                trials.append(
                    blank if candidate is None else self._ours(blank, seen, candidate, way)
                )
        if task.markers:
            for printed in self.markers:
                trials += self._theirs(task, printed)
        return trials

    def album(self, cell: Cell, printed: str) -> Album:
        """The pictures of a cell."""
        s = self.setting
        return Album(cell, printed, s.seed, s.backgrounds, s.cache)

    def candidate(self, view: View) -> Candidate | None:
        """The detector's best candidate where the target truly is."""
        for one in group(self.detect(view.color_rgb), self.target, view.color_rgb):
            if view.shows(list(one.boxes.values())[-1].center_px, TOLERANCE):
                return one
        return None

    def _ours(self, blank: Trial, seen: View, candidate: Candidate, way: Localise) -> Trial:
        def answer(camera: RgbdCamera) -> Localisation | Refusal:
            return way(
                seen.color_rgb, seen.depth_units, camera, candidate, self.target, seen.up_camera
            )

        trial = judged(blank, answer(CAMERA), seen.camera_from_target)
        if blank.way == OURS and trial.localised:
            drawn = answer(miscalibrated(CAMERA, np.random.default_rng(trial.index)))
            return replace(
                trial, squared_drawn=judged(blank, drawn, seen.camera_from_target).squared
            )
        return trial

    def _theirs(self, task: Task, printed: str) -> list[Trial]:
        view = self.album(task.cell, printed).view(task.index)
        if view is None:
            return []
        poses: dict[str, Pose] = {}
        for centre, ways in self.markers[printed](view.color_rgb):
            if view.shows(centre, TOLERANCE):
                poses = ways
                break
        trials = []
        for way in WAYS[printed]:
            blank = _blank(task, view, way, Sight.ALL)
            pose = poses.get(way)
            trials.append(blank if pose is None else _scored(blank, pose, view.camera_from_target))
        return trials


def miscalibrated(camera: RgbdCamera, rng: np.random.Generator) -> RgbdCamera:
    """A camera with an error drawn from the budget that the localiser's covariance holds.

    The focal length's share stands for the print's size as well: the picture knows their ratio
    alone. The line of sight's is the principal point's.
    """
    color = camera.color
    focal = 1 + rng.normal(0.0, SIZE_SIGMA)
    cx, cy = rng.normal((color.cx, color.cy), BEARING_SIGMA_RAD * color.fx)
    off = replace(color, fx=color.fx * focal, fy=color.fy * focal, cx=float(cx), cy=float(cy))
    return replace(camera, color=off)


def localisers() -> dict[str, Localise]:
    """Our own, and the paper's where it is built in."""
    ways: dict[str, Localise] = {OURS: localise}
    try:
        from target_pose.pnp import localise_pnp
    except ImportError:
        return ways
    return ways | {PNP: localise_pnp}


def with_sight(view: View, sight: Sight, seed: int) -> View:
    """The same frame with a part of it taken away."""
    if sight is Sight.NO_DEPTH:
        return replace(view, depth_units=None)
    if sight is Sight.BLACK:
        rng = np.random.default_rng(seed)
        dark = rng.integers(0, BLACK_LEVEL, view.color_rgb.shape, np.uint8)
        return replace(view, color_rgb=dark)
    return view


def _blank(task: Task, view: View, way: str, sight: Sight) -> Trial:
    pose = view.camera_from_target
    cosine = -(pose.rotation[:, 0] @ pose.translation) / np.linalg.norm(pose.translation)
    condition = task.cell.condition if sight is Sight.ALL else str(sight)
    return Trial(
        task.cell.name,
        condition,
        task.cell.distance_m,
        task.index,
        way,
        tilt_deg=float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))),
    )


def judged(blank: Trial, answer: Localisation | Refusal, truth: Pose) -> Trial:
    """A trial of ours with what was answered and how far that is from the truth."""
    if isinstance(answer, Refusal):
        return replace(blank, found=True, refusal=str(answer))
    pose = answer.camera_from_target
    return replace(
        _scored(blank, pose, truth),
        method=str(answer.method),
        ambiguous=answer.ambiguous,
        roll_source=str(answer.roll_source),
        squared=squared_mahalanobis(pose_error(pose, truth), answer.covariance),
    )


def _scored(blank: Trial, estimate: Pose, truth: Pose) -> Trial:
    error = pose_error(estimate, truth)
    return replace(
        blank,
        found=True,
        position_mm=error.position_mm,
        normal_deg=error.normal_deg,
        roll_deg=float(np.degrees(error.roll_rad)),
        estimate=[*estimate.translation.tolist(), *estimate.q_wxyz.tolist()],
    )


_examiner: Examiner | None = None


def start(setting: Setting, markers: bool) -> None:
    """Make this process ready for ``examine``."""
    global _examiner
    _examiner = Examiner.open(setting, markers)


def examine(task: Task) -> list[Trial]:
    """All trials of one pose, in a process that ``start`` has made ready."""
    assert _examiner is not None
    return _examiner.examine(task)
