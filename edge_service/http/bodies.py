"""The bodies of the HTTP answers: what people and scripts read."""

from __future__ import annotations

import math
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from edge_service.pipeline import Found, Output
from rgbd_wire.geometry import Pose
from target_pose.localisation import Localisation
from target_pose.residuals import residuals, spread, tilt_rad

COVARIANCE_FRAME = "camera"
"""Both halves of a pose's covariance are in the colour camera's frame."""


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


class CircleBody(_Body):
    """Edge points of one printed circle."""

    diameter_m: float
    measured: int
    used: int = Field(description="The others were taken for outliers.")
    rms_px: float | None = Field(description="Used ones about the projected circle.")


class EvidenceBody(_Body):
    """What the pose rests on, and how well that fits."""

    range_ellipse_m: float | None = Field(description="As the circles (pnp: points) have it.")
    range_ellipse_sigma_m: float | None
    range_plane_m: float | None = Field(description="Distance as the depth alone has it.")
    range_plane_sigma_m: float | None
    ranges_apart_sigmas: float | None = Field(
        description="Plane range less ellipse range, over the standard deviation of the difference."
    )
    ellipse_rms_px: float | None = Field(description="Edge points about the circles; pnp: points.")
    ellipse_points: int = Field(description="Edge points used.")
    ellipse_points_measured: int
    circles: list[CircleBody] = Field(description="The same for each circle, outermost first.")
    picture_points: int = Field(
        description="Pixels used, of a small target whose pixels were fitted instead of its edges."
    )
    picture_rms_levels: float | None = Field(description="Those about what the pose predicts.")
    plane_inliers: int
    plane_rms_m: float | None = Field(description="Depth points about the fitted plane.")
    depth_contradicts: bool = Field(description="Depth was left out: it contradicts the circles.")

    @classmethod
    def of(cls, located: Localisation) -> EvidenceBody:
        """The body of what a pose rests on."""
        r = residuals(located)
        circles = () if r is None else r.circles
        return cls(
            range_ellipse_m=located.range_ellipse_m,
            range_ellipse_sigma_m=None if r is None else r.range_ellipse_sigma_m,
            range_plane_m=located.range_plane_m,
            range_plane_sigma_m=None if r is None else r.range_plane_sigma_m,
            ranges_apart_sigmas=None if r is None else r.ranges_apart_sigmas,
            ellipse_rms_px=located.ellipse_rms_px,
            ellipse_points=located.ellipse_points,
            ellipse_points_measured=sum(c.measured for c in circles),
            circles=[CircleBody(**c._asdict()) for c in circles],
            picture_points=located.picture_points,
            picture_rms_levels=located.picture_rms_levels,
            plane_inliers=located.plane_inliers,
            plane_rms_m=located.plane_rms_m,
            depth_contradicts=located.depth_contradicts,
        )


class SigmasBody(_Body):
    """Standard deviations for people; ``covariance`` has all of it."""

    right_down_forward_mm: tuple[float, float, float] = Field(
        description="Position along the camera's axes."
    )
    range_mm: float = Field(description="Position along the line of sight.")
    across_mm: float = Field(description="Position across it, in the worse direction.")
    normal_deg: float = Field(description="The board's normal, in the worse direction.")
    roll_deg: float = Field(description="About the normal.")

    @classmethod
    def of(cls, located: Localisation) -> SigmasBody:
        """The body of a pose's standard deviations."""
        s = spread(located)
        right, down, forward = (1000 * math.sqrt(located.covariance[i, i]) for i in range(3))
        return cls(
            right_down_forward_mm=(right, down, forward),
            range_mm=1000 * s.range_m,
            across_mm=1000 * s.across_m,
            normal_deg=math.degrees(s.normal_rad),
            roll_deg=math.degrees(s.roll_rad),
        )


class TargetBody(_Body):
    """Where the target is, how sure that is, and how it was found."""

    camera_from_target: PoseBody = Field(
        description="Camera: x right, y down, z forward. Target: origin in the printed centre, "
        "x out of the board towards the viewer, z up along the board."
    )
    distance_m: float = Field(description="From the camera to the target's centre.")
    tilt_deg: float = Field(description="Between the board's normal and the line of sight.")
    sigmas: SigmasBody
    covariance_frame: str = Field(description="Frame in which the covariance is: camera.")
    covariance: list[list[float]] = Field(
        description="6x6 of (translation, rotation vector), both in the camera frame "
        "[m^2, m rad, rad^2]: the true pose is translation + d, exp(r) @ rotation."
    )
    method: str = Field(
        description="fused, ellipse, depth or box: from best evidence to weakest; pnp: by points."
    )
    roll_source: str = Field(description="What fixes the roll: edges, points, gravity or assumed.")
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
            tilt_deg=math.degrees(tilt_rad(located)),
            sigmas=SigmasBody.of(located),
            covariance_frame=COVARIANCE_FRAME,
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
            evidence=EvidenceBody.of(located),
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
    method: str = Field(description="How it is localised: fused or pnp.")
    detector: dict[str, Any]
