"""One frame without a service: the same stages, once, and what they found for people to read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from edge_service.drawing.draw import draw
from edge_service.drawing.files import write_drawing
from edge_service.drawing.findings import Findings, look
from edge_service.http.bodies import EvidenceBody, LocalizeBody, TargetBody
from edge_service.parts import make_pipeline
from edge_service.settings import EdgeSettings
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.frame import RgbdFrame
from target_pose.target import Target


@dataclass(frozen=True, slots=True, eq=False)
class OneFrame:
    """What was found in one frame, for scripts and for people."""

    body: LocalizeBody
    target: Target
    findings: Findings

    @property
    def found(self) -> bool:
        """There is a pose."""
        return self.body.target is not None


def localise_frame(frame: RgbdFrame, settings: EdgeSettings) -> OneFrame:
    """Load the detector and look for the target in one frame."""
    pipeline = make_pipeline(settings, MonotonicClock())
    findings = look(pipeline, frame)
    body = LocalizeBody.of(findings.output, pipeline.detector.model_hash)
    return OneFrame(body, pipeline.target, findings)


def draw_frame(path: Path, frame: RgbdFrame, seen: OneFrame) -> None:
    """Write a picture of what was found.

    Raises:
        OutputError: it cannot be written.
    """
    write_drawing(path, draw(frame.color_rgb, frame.camera.color, seen.target, seen.findings))


def report(body: LocalizeBody) -> Table:
    """A small table of what was found."""
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("outcome", body.outcome)
    if body.reason:
        table.add_row("reason", body.reason)
    if body.target is not None:
        for name, value in _rows(body.target):
            table.add_row(name, value)
    spent = ", ".join(f"{stage} {ms:.1f}" for stage, ms in body.timings_ms.items())
    table.add_row("time", f"{spent} ms")
    return table


def _rows(target: TargetBody) -> list[tuple[str, str]]:
    pose, sigmas, seen = target.camera_from_target, target.sigmas, target.evidence
    across = _numbers(sigmas.right_down_forward_mm, ".1f")
    rows = [
        ("distance", f"{target.distance_m:.3f} m +- {sigmas.range_mm:.1f} mm"),
        ("position", _numbers(pose.translation_m, "+.4f") + " m in camera (right, down, forward)"),
        ("+- 1 sigma", f"{across} mm"),
        ("tilt", f"{target.tilt_deg:.1f} deg +- {sigmas.normal_deg:.2f} deg of the normal"),
        ("q_wxyz", _numbers(pose.q_wxyz, "+.4f")),
        ("method", f"{target.method}, roll by {target.roll_source}, score {target.score:.2f}"),
    ]
    if seen.ellipse_rms_px is not None and target.method == "pnp":
        points = f"{seen.ellipse_points} used, rms {seen.ellipse_rms_px:.3f} px"
        rows.append(("points", points))
    elif seen.ellipse_rms_px is not None:
        points = f"{seen.ellipse_points} of {seen.ellipse_points_measured} edge points"
        rows.append(("circles", f"{points}, rms {seen.ellipse_rms_px:.3f} px"))
    if seen.picture_rms_levels is not None:
        rms = f"{seen.picture_rms_levels:.1f} grey levels"
        rows.append(("picture", f"{seen.picture_points} pixels of a small target, rms {rms}"))
    if seen.plane_rms_m is not None:
        rows.append(("plane", f"{seen.plane_inliers} points, rms {1000 * seen.plane_rms_m:.1f} mm"))
    if seen.range_plane_m is not None and seen.range_ellipse_m is not None:
        rows.append(("ranges", _ranges(seen, "points" if target.method == "pnp" else "circles")))
    if target.ambiguous and target.alternative is not None:
        other = _numbers(target.alternative.q_wxyz, "+.4f")
        rows.append(("ambiguous", f"the mirrored fold fits as well: q_wxyz {other}"))
    return rows


def _ranges(seen: EvidenceBody, picture: str) -> str:
    """What the picture (circles or points) and depth say of the distance, each by itself."""
    text = f"{seen.range_ellipse_m:.4f} m by the {picture}, {seen.range_plane_m:.4f} m by the depth"
    if seen.ranges_apart_sigmas is not None:
        text += f": {abs(seen.ranges_apart_sigmas):.1f} sigma apart"
    return text + (", which was left out" if seen.depth_contradicts else "")


def _numbers(values: tuple[float, ...] | list[float], form: str) -> str:
    return " ".join(format(v, form) for v in values)
