"""One look with the drone's own eyes, for the moments without a link (docs/freshness.md).

``predict`` says where the edge's last word puts the target in a picture, ``look`` measures it
there, and ``judge`` says whether what was measured may be flown on. There is no net on board: that
it is the target, and nothing else, is known from the edge alone. So every look is held against the
**edge's** last word, widened by odometry's drift since then, and never against another look: many
small steps cannot lead away from what the edge saw.

Pure: no clock, no thread, no I/O.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import cv2
import numpy as np

from drone_client.target import (
    Source,
    TargetEstimate,
    TargetMeasurement,
    Update,
    drift_covariance,
    measure,
    update,
)
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Array, Pose
from target_pose.candidate import Candidate
from target_pose.localisation import Localisation, Method, Refusal
from target_pose.localise import localise
from target_pose.nesting import EXPECTED_PX
from target_pose.rings import shades_share
from target_pose.target import Target
from target_pose.vectors import cross, orthogonal_to
from target_pose.window import NO_NET, projected_boxes, share_in_picture

GATE_CHI2: Final = 20.52
"""Squared Mahalanobis distance of position and normal, five degrees of freedom, 99.9 %. Stricter
than the edge's own gate: to lose a look costs a frame, to take a wrong one the flight."""
MIN_SHADES_SHARE: Final = 0.8
"""Least share of rays on which the rings have the right shades. The edge asks for half of them from
boxes that its net is sure of; here they stand alone."""
MIN_IN_PICTURE: Final = 0.6
"""Least share of the outer disc that the prediction has inside the picture."""
MAX_RANGE_GAP: Final = 0.05
"""By how much the ranges of circles and depth may differ: the check of the target's size. The edge,
whose net knows the target, lets 15 % through."""
BEHIND_M: Final = 0.05
"""Nothing nearer to the camera than this is a target that can be seen."""


class LookVerdict(StrEnum):
    """What became of a frame while the drone is on its own; all but ACCEPTED are reasons."""

    ACCEPTED = "accepted"
    DENIED = "denied"
    """The edge has looked again since, and saw no target: it is asked, and nobody else."""
    CONTESTED = "contested"
    """What the edge saw last disagrees with its own estimate."""
    EXPIRED = "expired"
    """The edge has been silent for longer than the drone may fly on its own eyes."""
    NO_OWN_POSE = "no_own_pose"
    """The drone does not know where it was at the exposure."""
    OTHER_CAMERA = "other_camera"
    """The frame is of another camera than those before."""
    TOO_UNSURE = "too_unsure"
    """The gate would be so wide that another target might stand in it."""
    OUT_OF_VIEW = "out_of_view"
    """The target should lie behind the camera, or too little of it in the picture."""
    DISPLACED = "displaced"
    """A newer frame came before this one was looked at."""
    REFUSED = "refused"
    """The localiser refuses it; its reason stands beside."""
    NO_CIRCLE = "no_circle"
    """No printed circle is seen: what is left would be the prediction in other words."""
    AMBIGUOUS = "ambiguous"
    """Two folds fit."""
    DEPTH_CONTRADICTS = "depth_contradicts"
    """Circles and depth do not agree on where the board is."""
    WRONG_RINGS = "wrong_rings"
    """The rings have not the target's shades where they should."""
    OFF_PREDICTION = "off_prediction"
    """Further from the edge's last word than drift and noise explain."""
    CONTRADICTED = "contradicted"
    """It was accepted, and then a late word of the edge disagreed."""
    TOO_OLD = "too_old"
    """Older than a pose may be by the time it was judged."""
    FAILED = "failed"
    """An error; the log has the first."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where the target must be in a picture."""

    anchor: TargetEstimate
    """The edge's last word."""
    world_from_camera: Pose
    """At the exposure."""
    candidate: Candidate
    """The window: a box for each level that can be seen."""
    up_camera: Array  # (3,)
    """The board's own up: tells its four edges apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A frame that was looked at, or why it was not, or why it is of no use."""

    verdict: LookVerdict
    detail: str = ""
    localisation: Localisation | None = None
    measurement: TargetMeasurement | None = None
    """In the world; None: nothing was measured."""
    shades_share: float | None = None
    """Share of the rays on which the rings are right."""
    distance2: float | None = None
    """Squared Mahalanobis distance from the prediction."""
    estimate: TargetEstimate | None = None
    """What may be flown on; None unless accepted."""


def predict(
    anchor: TargetEstimate,
    newest: TargetEstimate,
    world_from_camera: Pose,
    t_capture_ns: int,
    camera: RgbdCamera,
    target: Target,
) -> Prediction | LookVerdict:
    """The window of a frame, or why there is none.

    Args:
        anchor: the edge's last word; every look is judged by it.
        newest: the newest estimate of all, which places the window.
        world_from_camera: the colour camera at the exposure.
        t_capture_ns: exposure, drone's clock.
        camera: the rig.
        target: what was printed.
    """
    camera_from_target = world_from_camera.inverse() @ newest.world_from_target
    range_m = float(np.linalg.norm(camera_from_target.translation))
    position = _predicted(anchor, t_capture_ns)[:3, :3]
    position = position + (anchor.budget.sigma_rad * range_m) ** 2 * np.eye(3)
    if not _gate_reach_m(position) <= _reach_max_m(target):
        return LookVerdict.TOO_UNSURE
    faces = float(camera_from_target.rotation[:, 0] @ camera_from_target.translation) < 0
    if camera_from_target.translation[2] < BEHIND_M or not faces:
        return LookVerdict.OUT_OF_VIEW
    boxes = {
        level: box
        for level, box in projected_boxes(target, camera_from_target, camera.color).items()
        if max(box.size_px) >= EXPECTED_PX and share_in_picture(box, camera.color) >= MIN_IN_PICTURE
    }
    if not boxes:
        return LookVerdict.OUT_OF_VIEW
    up_camera = camera_from_target.rotation[:, 2]
    return Prediction(anchor, world_from_camera, Candidate(boxes, NO_NET), up_camera)


def look(frame: RgbdFrame, prediction: Prediction, target: Target) -> Look:
    """Measure the target in the predicted window, and judge it; some milliseconds of work."""
    found = localise(
        frame.color_rgb,
        frame.depth_units,
        frame.camera,
        prediction.candidate,
        target,
        prediction.up_camera,
    )
    if isinstance(found, Refusal):
        return Look(LookVerdict.REFUSED, found.value)
    if (weak := _weakness(found)) is not None:
        return Look(weak, found.method.value, found)
    share = _shades(frame, found, target)
    measurement = measure(
        prediction.world_from_camera,
        found.camera_from_target,
        found.covariance,
        frame.t_capture_ns,
        epoch=prediction.anchor.epoch,
        budget=prediction.anchor.budget,
    )
    if not share >= MIN_SHADES_SHARE:
        return Look(LookVerdict.WRONG_RINGS, "", found, measurement, share)
    judged = judge(measurement, prediction.anchor, target)
    return replace(judged, localisation=found, shades_share=share)


def judge(measurement: TargetMeasurement, anchor: TargetEstimate, target: Target) -> Look:
    """Whether a look agrees with the edge's last word, and the estimate that the two make.

    The estimate is the edge's word, aged, fused with this one look: it takes over without a jump,
    and no look before it has a say. Its covariance is widened by odometry's drift since the edge
    saw the target last: nobody has confirmed it since.
    """
    m = measurement
    spread = _predicted(anchor, m.t_capture_ns) + m.covariance
    if not (np.isfinite(spread).all() and _gate_reach_m(spread[:3, :3]) <= _reach_max_m(target)):
        return Look(LookVerdict.TOO_UNSURE, measurement=m)
    off = distance2(m.world_from_target, anchor.world_from_target, spread)
    if not off <= GATE_CHI2:
        return Look(LookVerdict.OFF_PREDICTION, measurement=m, distance2=off)
    fused, done = update(replace(anchor, outliers=0), m, anchor.budget)
    if done is not Update.FUSED:
        # Position and normal agree, the turn about the normal does not
        return Look(LookVerdict.OFF_PREDICTION, "roll", measurement=m, distance2=off)
    alone_ns = m.t_capture_ns - anchor.t_capture_ns
    estimate = replace(
        fused,
        covariance=fused.covariance + drift_covariance(alone_ns, anchor.budget),
        source=Source.ONBOARD,
        t_confirmed_ns=anchor.t_capture_ns,
    )
    return Look(LookVerdict.ACCEPTED, measurement=m, distance2=off, estimate=estimate)


def distance2(seen: Pose, predicted: Pose, spread: Array) -> float:
    """Squared Mahalanobis distance of two poses' positions and normals; infinite where undefined.

    Args:
        seen: ``world_from_target``, as ``predicted``.
        predicted: the same target.
        spread: (6, 6) covariance of their difference, translation first, world axes.
    """
    before, now = predicted.rotation[:, 0], seen.rotation[:, 0]
    axes = np.stack(orthogonal_to(before))  # (2, 3); a turn about the normal moves no normal
    sine = cross(before, now)
    length = math.sqrt(float(sine @ sine))
    angle = math.atan2(length, float(before @ now))
    turn = sine * (angle / length if length > 1e-12 else 1.0)
    if angle > math.pi / 2:
        return math.inf  # the board's back, or nearly so: no small turn
    miss = np.concatenate([seen.translation - predicted.translation, axes @ turn])
    pick = np.zeros((5, 6))
    pick[:3, :3], pick[3:, 3:] = np.eye(3), axes
    try:
        value = float(miss @ np.linalg.solve(pick @ spread @ pick.T, miss))
    except np.linalg.LinAlgError:
        return math.inf
    return value if value >= 0 else math.inf  # a NaN, or no covariance


def _predicted(anchor: TargetEstimate, t_capture_ns: int) -> Array:
    """Covariance (6, 6) of the edge's last word at a later time."""
    alone_ns = t_capture_ns - anchor.t_capture_ns
    return anchor.covariance + drift_covariance(alone_ns, anchor.budget)


def _gate_reach_m(position: Array) -> float:
    """How far from the prediction the gate reaches, for a position's covariance (3, 3).

    Infinite where that is no number.
    """
    if not np.isfinite(position).all():
        return math.inf
    return math.sqrt(GATE_CHI2 * max(float(np.linalg.eigvalsh(position)[-1]), 0.0))


def _reach_max_m(target: Target) -> float:
    """Another print of this size hangs at least a disc's diameter away: the gate stays short."""
    return target.discs[0].diameter_m


def _weakness(found: Localisation) -> LookVerdict | None:
    """Why a pose proves nothing to somebody who has only a prediction to start from."""
    if found.method not in (Method.FUSED, Method.ELLIPSE):
        return LookVerdict.NO_CIRCLE
    if not np.isfinite(found.covariance).all():
        return LookVerdict.TOO_UNSURE
    circles_m, plane_m = found.range_ellipse_m, found.range_plane_m
    gap = 0.0 if circles_m is None or plane_m is None else abs(plane_m / circles_m - 1)
    if not gap <= MAX_RANGE_GAP:
        return LookVerdict.DEPTH_CONTRADICTS
    return LookVerdict.AMBIGUOUS if found.ambiguous else None


def _shades(frame: RgbdFrame, found: Localisation, target: Target) -> float:
    """The edge's own check of the rings, at the boxes that the measured pose has."""
    boxes = projected_boxes(target, found.camera_from_target, frame.camera.color)
    gray = np.asarray(cv2.cvtColor(frame.color_rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    return shades_share(gray, boxes, target)
