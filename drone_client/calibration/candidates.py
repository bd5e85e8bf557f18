"""Where in a frame the target is: as a worker, an earlier run, or the recording's truth has it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

import cv2

from drone_client.errors import LinkError, SourceError
from drone_client.run_files import LEDGER_NAME
from drone_client.source import Capture
from drone_client.summary import read_lines
from drone_client.truth import TruthEntry
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.messages import Outcome
from target_pose.candidate import Box, Candidate
from target_pose.target import Level, Target
from target_pose.window import projected_boxes, share_in_picture

MIN_VISIBLE: Final = 0.999
"""Share of the target that the picture must hold, where the truth tells."""


class WhereIsIt(Protocol):
    """Finds the target in a frame, in the colour picture alone."""

    def __call__(self, number: int, capture: Capture) -> Candidate | str:
        """Its boxes, or why there are none; ``number`` counts the recording's frames."""
        ...


class FromWorker:
    """Asks an edge service over HTTP. Depth is left out: it is what is to be judged."""

    def __init__(self, url: str, camera: RgbdCamera, target: Target, timeout_s: float) -> None:
        from drone_client.snap import ask  # httpx comes with the extra "drone"

        self._ask = ask
        self._url, self._timeout_s, self._target = url, timeout_s, target
        whole = camera.to_json()
        bare = {name: whole[name] for name in ("color", "depth_scale_m")}
        self._camera = json.dumps(bare).encode()

    def check(self) -> None:
        """Tell before the first frame whether this worker can be asked.

        Raises:
            LinkError: nobody answers there.
            SourceError: the worker looks for another target.
        """
        from drone_client.snap import get

        theirs = get(self._url, "/v1/model", self._timeout_s).get("target")
        sizes = _diameters(theirs)
        mine = [disc.diameter_m for disc in self._target.discs]
        if sizes != mine:
            name = theirs.get("name") if isinstance(theirs, dict) else theirs
            raise SourceError(
                f"the worker at {self._url} looks for {str(name)[:64]} and not for "
                f"{self._target.name}: start it with --target, or name its target here"
            )

    def __call__(self, number: int, capture: Capture) -> Candidate | str:
        """The worker's boxes."""
        done, png = cv2.imencode(".png", capture.color_rgb[..., ::-1])
        assert done
        files = {
            "color": ("color.png", png.tobytes()),
            "camera": ("camera.json", self._camera),
        }
        body = self._ask(self._url, files, self._timeout_s)
        outcome = body.get("outcome")
        if outcome != Outcome.TARGET.value:
            return f"worker: {str(outcome)[:40]}"
        try:
            boxes = {
                Level(b["level"]): _box([b[k] for k in ("x0", "y0", "x1", "y1", "score")])
                for b in body["target"]["boxes"]
            }
            return Candidate(boxes, float(body["target"]["score"]))
        except (KeyError, TypeError, ValueError):
            raise LinkError(f"{self._url} answered without boxes: is it edge-service?") from None


class FromRun:
    """The boxes that workers found in an earlier replay of the same recording."""

    def __init__(self, folder: Path) -> None:
        ledger = folder / LEDGER_NAME if folder.is_dir() else folder
        try:
            lines = read_lines(ledger)
        except (OSError, ValueError) as error:
            raise SourceError(f"run {folder}: {ledger.name} cannot be read: {error}") from None
        known = (line for line in lines if isinstance(line, dict) and line.get("boxes"))
        self._boxes = {line.get("name"): line["boxes"] for line in known}
        if not self._boxes:
            raise SourceError(f"run {folder}: no frame in {ledger.name} has boxes of a target")

    def __call__(self, number: int, capture: Capture) -> Candidate | str:
        """The run's boxes."""
        sides = self._boxes.get(capture.name)
        if sides is None:
            return "not found in that run"
        try:
            boxes = {Level(level): _box(b) for level, b in sides.items()}
        except (TypeError, ValueError, AttributeError):
            raise SourceError(f"the ledger's boxes of {capture.name} are none") from None
        return Candidate(boxes, min(b.score for b in boxes.values()))


@dataclasses.dataclass(frozen=True, slots=True)
class FromTruth:
    """Boxes around where the target truly is; what is measured there does not use the truth."""

    entries: tuple[TruthEntry, ...]
    camera: RgbdCamera
    target: Target

    def __call__(self, number: int, capture: Capture) -> Candidate | str:
        """The truth's boxes."""
        entry = self.entries[number]
        if entry.visible < MIN_VISIBLE:
            return "not whole in the picture"
        boxes = projected_boxes(self.target, entry.camera_from_target, self.camera.color)
        if not any(share_in_picture(b, self.camera.color) for b in boxes.values()):
            return "not in the picture"
        return Candidate(boxes, 1.0)


def _box(numbers: Sequence[Any]) -> Box:
    """Of x0, y0, x1, y1 and score; raises what a wrong number of wrong things raises."""
    x0, y0, x1, y1, score = (float(n) for n in numbers)
    return Box(x0, y0, x1, y1, score)


def _diameters(target: Any) -> list[float]:
    """Of the discs of a target as ``GET /v1/model`` has it."""
    discs = target.get("discs") if isinstance(target, Mapping) else None
    if not isinstance(discs, list):
        return []
    return [d["diameter_m"] for d in discs if isinstance(d, Mapping) and "diameter_m" in d]
