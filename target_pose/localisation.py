"""What the localiser says about one candidate: a pose with its covariance, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.geometry import Pose
from target_pose.conic import CirclePose
from target_pose.plane import InverseDepthPlane


class Method(StrEnum):
    """What a pose rests on, from the best evidence to the weakest."""

    FUSED = "fused"
    """The printed circles in the picture and the board's plane in the depth, fused."""
    ELLIPSE = "ellipse"
    """The circles alone: no depth on the board. The normal may be the mirrored one."""
    DEPTH = "depth"
    """The plane alone, with the bearing of the box: no circle to be seen in the picture."""
    BOX = "box"
    """Bearing and apparent size of the box alone; the board is taken to face the camera."""
    PNP = "pnp"
    """The method chosen instead of all of the above (``pnp.localise_pnp``): points with known
    places on the board, and the board's plane where there is depth."""


class Refusal(StrEnum):
    """Why a candidate has no pose."""

    BAD_INPUT = "bad_input"
    """The picture, the depth or the up vector has not the shape or type that the camera says."""
    BAD_INTRINSICS = "bad_intrinsics"
    """The lens model has no usable inverse where the candidate lies."""
    BAD_BOX = "bad_box"
    """No level has a box that is finite, not empty and inside the picture."""
    TOO_SMALL = "too_small"
    """The outer disc would be only a few pixels wide."""
    GRAZING = "grazing"
    """The board is seen from so flat an angle that neither its normal nor its range is sure."""
    INCONSISTENT = "inconsistent"
    """Picture and depth measure ranges that cannot both be true: a wrong depth unit, a target of
    another size, or a look-alike. Which of the two is wrong cannot be known from here."""
    POINTS_DISAGREE = "points_disagree"
    """Labelled points are not where any pose of the target would put them: a look-alike, or a net
    whose key points have another order than the target's file."""
    BEHIND_CAMERA = "behind_camera"
    """The solution does not lie in front of the camera, or shows the board's back."""
    NO_EVIDENCE = "no_evidence"
    """No circle, no plane, and a box that says nothing (cut by the picture's border)."""


class RollSource(StrEnum):
    """What fixes the rotation about the board's normal, which circles do not show."""

    EDGES = "edges"
    """The board's four edges; which of them is the upper one is told by the two below."""
    POINTS = "points"
    """Labelled points of the board: each of them tells where up is."""
    GRAVITY = "gravity"
    """The caller's up vector: the board is taken to hang upright."""
    ASSUMED = "assumed"
    """Nothing: the board's up is taken to be the camera's up."""


class CirclesFit(Protocol):
    """A pose of the printed circles, up to its roll, however it was measured."""

    @property
    def pose(self) -> CirclePose:
        """Centre and normal."""
        ...

    @property
    def information(self) -> NDArray[np.float64]:
        """Inverse covariance (6, 6), as ``covariance_from_information`` takes it."""
        ...


class Evidence(NamedTuple):
    """What a pose was made of, kept for people who want to look at it."""

    circles: CirclesFit
    """The fit that gave the pose; ``fusion.CircleFit`` has edge points."""
    circles_alone: CirclesFit
    """The same without the depth."""
    plane: InverseDepthPlane | None
    """The board in the depth, whether it was used or contradicts."""


@dataclass(frozen=True, slots=True, eq=False)
class Localisation:
    """Where one target is.

    The covariance is that of the six-vector (dx, dy, dz [m], rx, ry, rz [rad]), both halves in the
    camera frame: the true pose is ``translation + d`` and ``rotation_from_vector(r) @ rotation``.
    """

    camera_from_target: Pose
    covariance: NDArray[np.float64]  # (6, 6) [m^2, m rad, rad^2]
    """Symmetric and positive definite; translation first."""
    method: Method
    roll_source: RollSource
    alternative: Pose | None = None
    """The other fold: the second pose from which the outer circle looks the same."""
    ambiguous: bool = False
    """Nothing tells the two folds apart; the covariance spans both."""
    range_ellipse_m: float | None = None
    """Distance to the target's centre as the circles (``PNP``: the points) alone have it."""
    range_plane_m: float | None = None
    """Distance to the plane along the target's bearing as the depth alone has it."""
    ellipse_rms_px: float | None = None
    """Root mean square of the used edge points about the fitted circles; ``PNP``: of the points."""
    ellipse_points: int = 0
    """Edge points used; ``PNP``: labelled points, or points of the board's edges."""
    picture_rms_levels: float | None = None
    """Of a small target, all of whose pixels were fitted: root mean square of the used ones about
    what the pose predicts [grey values]."""
    picture_points: int = 0
    """Pixels used."""
    plane_inliers: int = 0
    """Depth points used."""
    plane_rms_m: float | None = None
    """Root mean square of the used depth points about the plane, along the line of sight."""
    depth_contradicts: bool = False
    """Depth was seen on the board but left out, since it contradicts the circles by more than the
    errors of both allow; the covariance is widened to reach it."""
    evidence: Evidence | None = None
    """None: the pose does not rest on circles."""
