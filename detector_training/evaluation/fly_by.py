"""The paper's figure: the sum of detections over a flight, beside when the target was in view."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.sample import MAX_IMAGE_BYTES
from detector_training.errors import EvaluationError
from detector_training.evaluation.figures import COLOURS, WIDTHS, figure
from detector_training.evaluation.run import Detect
from target_pose.candidate import Detections
from target_pose.nesting import group
from target_pose.target import Level, Target

TRUTH_FILES = ("truth.json", "targets.json")
IN_VIEW = 0.5
"""From this visible share of the board on the target counts as in view."""
MATCH_S = 0.02
"""A frame and its truth are at most so far apart."""
MAX_LIST_BYTES = 64 << 20


@dataclass(frozen=True, slots=True)
class Frame:
    """One colour picture of a recording and what is true then."""

    t_s: float
    image: Path
    visible: float
    """Share of the board in the picture and not hidden, [0, 1]."""

    def read(self) -> NDArray[np.uint8]:
        """The picture, RGB (H, W, 3).

        Raises:
            EvaluationError: it cannot be read.
        """
        try:
            too_large = self.image.stat().st_size > MAX_IMAGE_BYTES
            data = b"" if too_large else self.image.read_bytes()
        except OSError as error:
            raise EvaluationError(f"picture {self.image}: {error.strerror}") from None
        rgb = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB) if data else None
        if rgb is None:
            raise EvaluationError(f"picture {self.image} cannot be decoded")
        return np.asarray(rgb, np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class FlyBy:
    """What was found in each of F frames."""

    t_s: NDArray[np.float64]  # (F,), from the first frame on
    in_view: NDArray[np.bool_]  # (F,)
    visible: NDArray[np.float64]  # (F,)
    found: dict[Level, NDArray[np.bool_]]  # (F,) each
    """Levels of the frame's best candidate, after the nesting check."""

    def as_json(self) -> dict[str, Any]:
        """Counts, in view and out of it."""
        any_level = np.any(list(self.found.values()), axis=0)
        return {
            "frames": len(self.t_s),
            "in_view": int(self.in_view.sum()),
            "found_in_view": int((any_level & self.in_view).sum()),
            "found_out_of_view": int((any_level & (self.visible == 0)).sum()),
            "detections": {level.value: int(f.sum()) for level, f in self.found.items()},
        }


def load_recording(folder: Path) -> tuple[Frame, ...]:
    """The frames of a recording in the TUM layout that has a truth file.

    Raises:
        EvaluationError: names the file and the line at fault.
    """
    names = [name for name in TRUTH_FILES if (folder / name).is_file()]
    if not names:
        raise EvaluationError(
            f"{folder} has no {' or '.join(TRUTH_FILES)}: a list of objects with t [s] and visible"
        )
    truth_path, list_path = folder / names[0], folder / "rgb.txt"
    try:
        entries = json.loads(_text(truth_path))
        times = np.array([float(e["t"]) for e in entries])
        visible = np.array([float(e["visible"]) for e in entries])
    except (ValueError, TypeError, RecursionError) as error:
        raise EvaluationError(f"{truth_path}: {error}") from None
    except KeyError as error:
        raise EvaluationError(f"{truth_path}: an entry lacks {error.args[0]}") from None
    if not (len(times) and np.isfinite(times).all() and ((visible >= 0) & (visible <= 1)).all()):
        raise EvaluationError(f"{truth_path}: t must be seconds, visible shares in [0, 1]")
    frames = []
    for number, line in enumerate(_text(list_path).splitlines(), 1):
        if not (fields := line.split("#")[0].split()):
            continue
        try:
            t_s, name = float(fields[0]), fields[1]
        except (ValueError, IndexError):
            raise EvaluationError(f"{list_path} line {number}: want 'seconds file'") from None
        nearest = int(np.argmin(np.abs(times - t_s)))
        if abs(times[nearest] - t_s) <= MATCH_S:
            frames.append(Frame(t_s, folder / name, float(visible[nearest])))
    if not frames:
        raise EvaluationError(f"{list_path}: no frame is within {MATCH_S} s of one in {truth_path}")
    return tuple(sorted(frames, key=lambda f: f.t_s))


def fly_by(
    detect: Detect,
    frames: Sequence[Frame],
    target: Target,
    on_progress: Callable[[int], None] = lambda done: None,
) -> FlyBy:
    """Look at each frame; at least one.

    Args:
        detect: With the threshold of the service.
        frames: In the order of time.
        target: For the nesting check.
        on_progress: Called with the number of frames done.

    Raises:
        EvaluationError: a picture cannot be read.
    """
    found: dict[Level, list[bool]] = {level: [] for level in Level}
    for done, frame in enumerate(frames, 1):
        rgb = frame.read()
        detections: Detections = detect(rgb)
        best = next(iter(group(detections, target, rgb)), None)
        for level in Level:
            found[level].append(best is not None and level in best.boxes)
        on_progress(done)
    visible = np.array([f.visible for f in frames])
    t_s = np.array([f.t_s for f in frames])
    return FlyBy(
        t_s - t_s[0],
        visible >= IN_VIEW,
        visible,
        {level: np.array(f, bool) for level, f in found.items()},
    )


def intervals_in_view(run: FlyBy) -> list[tuple[float, float]]:
    """From when to when [s] the target is in view; half a frame is added at both ends."""
    half = float(np.median(np.diff(run.t_s))) / 2 if len(run.t_s) > 1 else 0.5
    edges = np.flatnonzero(np.diff(np.concatenate([[False], run.in_view, [False]]).astype(int)))
    return [
        (float(run.t_s[a]) - half, float(run.t_s[b - 1]) + half)
        for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    ]


def plot_fly_by(run: FlyBy, name: str) -> bytes:
    """The sum of detections of each level over time as PNG, in-view intervals in yellow."""
    with figure((8, 4.5)) as (_, axis, file):
        for k, (start, end) in enumerate(intervals_in_view(run)):
            label = "target in view" if k == 0 else None
            axis.axvspan(start, end, color="#ffe680", alpha=0.7, lw=0, label=label)
        axis.step(
            run.t_s,
            np.cumsum(run.in_view),
            where="post",
            color="#909090",
            ls=":",
            label="frames in view",
        )
        for level, found in run.found.items():
            total = np.cumsum(found)
            label = f"{level.value} ({total[-1]})"
            axis.step(
                run.t_s,
                total,
                where="post",
                color=COLOURS[level.value],
                lw=WIDTHS[level.value],
                label=label,
            )
        axis.set(xlabel="time [s]", ylabel="sum of detections", title=f"Fly-by: {name}")
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8, loc="upper left")
    return file.getvalue()


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_LIST_BYTES:
            raise EvaluationError(f"{path} is over {MAX_LIST_BYTES} bytes")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise EvaluationError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise EvaluationError(f"{path} is not text") from None
