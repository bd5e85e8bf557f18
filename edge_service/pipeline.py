"""What happens to one frame: decode, detect, nest, localise.

Functions of values, but for the clock that times the stages; a bad frame and a frame without a
target are outcomes with a reason, not exceptions.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from edge_service.detector.letterbox import check_image
from edge_service.errors import ImageError
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.clock import Clock
from rgbd_wire.errors import DecodeError
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import PackedFrame, decompress
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Outcome
from target_pose.candidate import Candidate, Detections
from target_pose.localisation import Localisation, Refusal
from target_pose.target import Target

log = logging.getLogger(__name__)

MAX_REASON_CHARACTERS = 120
"""As much as a result on the wire may hold."""

WORLD_UP = np.array([0.0, 0.0, 1.0])
"""The frame ``world`` is ENU: z points away from gravity."""


class Detector(Protocol):
    """Finds the boxes of the target's levels in a colour picture."""

    @property
    def model_hash(self) -> str:
        """SHA-256 of the weights."""
        ...

    def detect(self, color_rgb: NDArray[np.uint8]) -> Detections:
        """All boxes of a picture (H, W, 3).

        Raises:
            ImageError: it takes no picture of that size.
        """
        ...

    def detect_batch(self, colors_rgb: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        """All boxes of each of several pictures (H, W, 3), maybe faster than one by one.

        Raises:
            ImageError: it does not take one of them.
        """
        ...

    def describe(self) -> dict[str, Any]:
        """What it is and how it runs, for people to read."""
        ...


Group: TypeAlias = Callable[[Detections, Target, NDArray[np.uint8]], tuple[Candidate, ...]]
"""Boxes to targets, best first; ``target_pose.nesting.group``."""


class Localise(Protocol):
    """Pose of one candidate; ``target_pose.localise.localise`` or ``pnp.localise_pnp``."""

    def __call__(
        self,
        color_rgb: NDArray[np.uint8],
        depth_units: NDArray[np.uint16] | None,
        camera: RgbdCamera,
        candidate: Candidate,
        target: Target,
        up_camera: NDArray[np.float64] | None = None,
    ) -> Localisation | Refusal:
        """The pose, or why there is none."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A target and where it is."""

    candidate: Candidate
    localisation: Localisation
    world_from_target: Pose | None
    """Through the drone's own pose at exposure; None: it gave none."""


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """What became of a frame."""

    outcome: Outcome
    reason: str = ""
    """Why there is no target; empty when there is one."""
    found: Found | None = None
    stages_ns: dict[str, int] = field(default_factory=dict)
    """Time that each stage took, in the order in which they ran."""


@dataclass(frozen=True, slots=True, eq=False)
class Pipeline:
    """The stages with what each of them needs, chosen once."""

    detector: Detector
    target: Target
    group: Group
    localise: Localise
    clock: Clock
    max_candidates: int = 3
    """How many candidates of one picture are tried, best first."""
    world_is_level: bool = True
    """``world_from_camera`` is ENU, so its z may tell which of the board's edges is the upper one.
    The circles and edges themselves never need it."""
    method: str = "fused"
    """What ``localise`` is called in the settings, for people."""

    def process(self, packed: PackedFrame) -> Output:
        """Decode a received frame and look for the target in it."""
        stages_ns: dict[str, int] = {}
        frame = self.decode(packed, stages_ns)
        return frame if isinstance(frame, Output) else self.locate(frame, stages_ns)

    def locate(self, frame: RgbdFrame, stages_ns: dict[str, int] | None = None) -> Output:
        """Look for the target in a frame; its stages are added to those that ran before."""
        stages_ns = {} if stages_ns is None else stages_ns
        (seen,) = self.detect([frame], [stages_ns])
        return self.conclude(frame, seen, stages_ns)

    def decode(self, packed: PackedFrame, stages_ns: dict[str, int]) -> RgbdFrame | Output:
        """The first stage: the frame, or why it is none."""
        try:
            with self._timed("decode", stages_ns):
                return decompress(packed)
        except DecodeError as error:
            return Output(Outcome.BAD_FRAME, bounded(str(error)), stages_ns=stages_ns)

    def detect(
        self, frames: Sequence[RgbdFrame], stages_ns: Sequence[dict[str, int]]
    ) -> list[Detections | Exception]:
        """The second stage, of several frames at once; what fails with one of them is its own.

        Args:
            frames: any number.
            stages_ns: of each; the stage took as long for one as for all.
        """
        start_ns = self.clock.now_ns()
        seen = self._detect(frames)
        spent_ns = self.clock.now_ns() - start_ns
        for stages in stages_ns:
            stages["detect"] = spent_ns
        return seen

    def _detect(self, frames: Sequence[RgbdFrame]) -> list[Detections | Exception]:
        # Singled out, so that one drone's frame does not cost the others their batch
        faults = [_fault(frame) for frame in frames]
        fit = [frame for frame, fault in zip(frames, faults, strict=True) if fault is None]
        seen = iter(self._detect_fit(fit))
        return [next(seen) if fault is None else fault for fault in faults]

    def _detect_fit(self, frames: Sequence[RgbdFrame]) -> list[Detections | Exception]:
        if len(frames) > 1:
            try:
                return list(self.detector.detect_batch([frame.color_rgb for frame in frames]))
            except Exception as error:  # one spoils it for all: then each by itself shows which
                log.warning("batch failed", extra={"frames": len(frames), "error": repr(error)})
        return [self._detect_one(frame) for frame in frames]

    def _detect_one(self, frame: RgbdFrame) -> Detections | Exception:
        try:
            return self.detector.detect(frame.color_rgb)
        except Exception as error:
            return error

    def conclude(
        self, frame: RgbdFrame, seen: Detections | Exception, stages_ns: dict[str, int]
    ) -> Output:
        """The rest, of one frame and what the detector saw in it."""
        if isinstance(seen, ImageError):
            return Output(Outcome.BAD_FRAME, bounded(str(seen)), stages_ns=stages_ns)
        if isinstance(seen, Exception):
            raise seen
        detections = seen
        n_boxes = sum(map(len, detections.boxes.values()))
        if n_boxes == 0:
            return Output(Outcome.NOTHING_FOUND, "no box", stages_ns=stages_ns)
        with self._timed("nest", stages_ns):
            candidates = self.group(detections, self.target, frame.color_rgb)
        if not candidates:
            reason = bounded(f"{n_boxes} boxes, none that nest as {self.target.name}")
            return Output(Outcome.NOT_A_TARGET, reason, stages_ns=stages_ns)
        with self._timed("localise", stages_ns):
            found = self._first_localised(frame, candidates)
        if isinstance(found, Refusal):
            return Output(Outcome.REFUSED, found.value, stages_ns=stages_ns)
        return Output(Outcome.TARGET, found=found, stages_ns=stages_ns)

    def _first_localised(
        self, frame: RgbdFrame, candidates: tuple[Candidate, ...]
    ) -> Found | Refusal:
        """The best candidate that has a pose, else why the best one of all has none."""
        world_from_camera = frame.world_from_camera
        up_camera = None
        if world_from_camera is not None and self.world_is_level:
            up_camera = world_from_camera.rotation.T @ WORLD_UP
        refusals = []
        for candidate in candidates[: self.max_candidates]:
            answer = self.localise(
                frame.color_rgb, frame.depth_units, frame.camera, candidate, self.target, up_camera
            )
            if isinstance(answer, Refusal):
                refusals.append(answer)
                continue
            world_from_target = None
            if world_from_camera is not None:
                world_from_target = world_from_camera @ answer.camera_from_target
            return Found(candidate, answer, world_from_target)
        return refusals[0]

    @contextmanager
    def _timed(self, stage: str, stages_ns: dict[str, int]) -> Iterator[None]:
        start_ns = self.clock.now_ns()
        try:
            yield
        finally:
            stages_ns[stage] = self.clock.now_ns() - start_ns


def _fault(frame: RgbdFrame) -> ImageError | None:
    """Why no detector takes a frame's picture; None: it may."""
    try:
        check_image(frame.color_rgb)
    except ImageError as error:
        return error
    return None


def bounded(reason: str) -> str:
    """A reason on one line, of a length that a result may hold."""
    line = " ".join(reason.split())
    if len(line) <= MAX_REASON_CHARACTERS:
        return line
    return line[: MAX_REASON_CHARACTERS - 3] + "..."
