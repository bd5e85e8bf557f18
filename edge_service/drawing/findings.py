"""What there is to draw of a frame: the boxes too, which an answer to a drone leaves out."""

from __future__ import annotations

from dataclasses import dataclass

from edge_service.pipeline import Output, Pipeline
from rgbd_wire.frame import RgbdFrame
from target_pose.candidate import Detections
from target_pose.target import Level


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Every box of a frame, and the pose or why there is none."""

    detections: Detections
    output: Output


def look(pipeline: Pipeline, frame: RgbdFrame) -> Findings:
    """As ``Pipeline.locate``, and keep the boxes."""
    stages_ns: dict[str, int] = {}
    (seen,) = pipeline.detect([frame], [stages_ns])
    output = pipeline.conclude(frame, seen, stages_ns)
    detections = Detections(dict.fromkeys(Level, ())) if isinstance(seen, Exception) else seen
    return Findings(detections, output)
