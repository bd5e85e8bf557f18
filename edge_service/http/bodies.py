"""The bodies of the HTTP answers: what people and scripts read."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from edge_service.pipeline import Found, Output
from rgbd_wire.geometry import Pose
from target_pose.localisation import Localisation


class _Body(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PoseBody(_Body):
    """A rigid transform ``a_from_b``, three times over: take the form that suits you."""

    translation_m: tuple[float, float, float] = Field(description="Origin of b in a [m].")
    q_wxyz: tuple[float, float, float, float] = Field(description="Unit quaternion, w first.")
    matrix: list[list[float]] = Field(description="Homogeneous 4x4: p_a = matrix @ p_b.")

    @classmethod
    def of(cls, pose: Pose) -> PoseBody:
        """A pose's body."""
        x, y, z = pose.translation.tolist()
        qw, qx, qy, qz = pose.q_wxyz.tolist()
        return cls(translation_m=(x, y, z), q_wxyz=(qw, qx, qy, qz), matrix=pose.matrix.tolist())


class BoxBody(_Body):
    """One detected level of the target, pixels of the colour picture."""

    level: str = Field(description="T_good (board), T_better (outer disc) or T_best (inner disc).")
    x0: float
    y0: float
    x1: float
    y1: float
    score: float = Field(description="Confidence in [0, 1].")


class EvidenceBody(_Body):
    """What the pose rests on."""

    range_ellipse_m: float | None = Field(description="Distance as the circles alone have it.")
    range_plane_m: float | None = Field(description="Distance as the depth alone has it.")
    ellipse_rms_px: float | None = Field(description="Edge points about the fitted circles.")
    ellipse_points: int
    plane_inliers: int
    plane_rms_m: float | None = Field(description="Depth points about the fitted plane.")
    depth_contradicts: bool = Field(description="Depth was left out: it contradicts the circles.")


class TargetBody(_Body):
    """Where the target is, how sure that is, and how it was found."""

    camera_from_target: PoseBody = Field(
        description="Camera: x right, y down, z forward. Target: origin in the printed centre, "
        "x out of the board towards the viewer, z up along the board."
    )
    distance_m: float = Field(description="From the camera to the target's centre.")
    covariance: list[list[float]] = Field(
        description="6x6 of (translation, rotation vector), both in the camera frame "
        "[m^2, m rad, rad^2]."
    )
    method: str = Field(description="fused, ellipse, depth or box: from best evidence to weakest.")
    roll_source: str = Field(description="What fixes the roll: edges, gravity or assumed.")
    ambiguous: bool = Field(description="Both folds fit; alternative is the other one.")
    alternative: PoseBody | None = Field(description="The other fold of the two conic poses.")
    score: float
    boxes: list[BoxBody]
    evidence: EvidenceBody

    @classmethod
    def of(cls, found: Found) -> TargetBody:
        """A target's body."""
        located: Localisation = found.localisation
        pose, fold = located.camera_from_target, located.alternative
        return cls(
            camera_from_target=PoseBody.of(pose),
            distance_m=float((pose.translation @ pose.translation) ** 0.5),
            covariance=located.covariance.tolist(),
            method=located.method.value,
            roll_source=located.roll_source.value,
            ambiguous=located.ambiguous,
            alternative=None if fold is None else PoseBody.of(fold),
            score=found.candidate.score,
            boxes=[
                BoxBody(level=level.value, x0=b.x0, y0=b.y0, x1=b.x1, y1=b.y1, score=b.score)
                for level, b in found.candidate.boxes.items()
            ],
            evidence=EvidenceBody(
                range_ellipse_m=located.range_ellipse_m,
                range_plane_m=located.range_plane_m,
                ellipse_rms_px=located.ellipse_rms_px,
                ellipse_points=located.ellipse_points,
                plane_inliers=located.plane_inliers,
                plane_rms_m=located.plane_rms_m,
                depth_contradicts=located.depth_contradicts,
            ),
        )


class LocalizeBody(_Body):
    """The answer to one picture."""

    outcome: str = Field(
        description="target, nothing_found, not_a_target (boxes that do not nest) or refused "
        "(a target without a pose that one could stand for)."
    )
    reason: str = Field(description="Why there is no target; empty when there is one.")
    target: TargetBody | None
    timings_ms: dict[str, float] = Field(description="Time of each stage, in order.")
    model: str = Field(description="SHA-256 of the detector's weights.")

    @classmethod
    def of(cls, output: Output, model_hash: str) -> LocalizeBody:
        """An output's body."""
        return cls(
            outcome=output.outcome.value,
            reason=output.reason,
            target=None if output.found is None else TargetBody.of(output.found),
            timings_ms={s: round(ns * 1e-6, 3) for s, ns in output.stages_ns.items()},
            model=model_hash,
        )


class ErrorBody(_Body):
    """What is wrong with a request, in one sentence."""

    field: str | None = Field(description="The form field at fault, if it is one.")
    detail: str


class LiveBody(_Body):
    """Whether the worker's loop goes round."""

    alive: bool
    silent_s: float | None = Field(description="Since it last came round; null before it starts.")


class ReadyBody(_Body):
    """Whether frames are taken, and if not, what is missing."""

    ready: bool
    model_warm: bool
    link_open: bool
    not_draining: bool


class ModelBody(_Body):
    """The detector and the target that it looks for."""

    worker: str
    version: str
    target: dict[str, Any]
    detector: dict[str, Any]
