"""The paper's way to a pose, selectable beside ``localise``: points, PnP and the cropped depth.

The paper (Section II-C) solves for the rotation and translation that take the target's points to
their pixels (E. Marchand, H. Uchiyama, F. Spindler, "Pose estimation for augmented reality: a
hands-on survey", 2016), and for the depth has the point cloud in the detected box. It leaves open
which points those are. Here they are, the best first:

1. the target's labelled points, where its file has ``[[points]]`` and the net gives them;
2. the corners of a bullseye's board. They are the only points of it with known places: a disc's
   outline has none, its centre is not the centre of its ellipse, and the centres of the boxes are
   neither. The boxes and the discs in them say where to look, the crossings of the four edges, each
   fitted to sub-pixel points along its whole length, where they are;
3. the sides of the discs' boxes, where an edge of the board is covered or cut: each touches its
   disc in a point that the pose determines.

IPPE and SQPnP start, Levenberg-Marquardt ends. The board's plane in the depth picks between the two
folds, and is fused by inverse variance where it agrees (the gate of ``localise``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from target_pose.align import depth_points_in_box, depth_points_in_ellipse
from target_pose.box_guess import MAX_COORDINATE_PX, box_guesses
from target_pose.candidate import Box, Candidate
from target_pose.covariance import covariance_from_information, floored, pose_offset, widened
from target_pose.fusion import plane_error
from target_pose.given import fits_camera, usable_up
from target_pose.lens import project
from target_pose.localisation import Localisation, Method, Refusal
from target_pose.localise import (
    BOARD_SHARE,
    BOX_TILT_SIGMA_RAD,
    GATE,
    GROSS_BOX_RATIO,
    GROSS_RATIO,
    MAX_TILT_RAD,
    SAME_FOLD_RAD,
    doubt,
)
from target_pose.plane import BoardPlane, InverseDepthPlane, board_plane
from target_pose.pnp_corners import corner_places
from target_pose.pnp_evidence import PnpEvidence, View, evidence_of
from target_pose.pnp_fit import PnpFit, fit_pose
from target_pose.roll import UNKNOWN_SIGMA_RAD
from target_pose.target import Target
from target_pose.vectors import angle, length, unit

Array: TypeAlias = NDArray[np.float64]

PINNED_RAD = 1e-3
"""As well as not at all may boxes turn a board that no depth was seen on."""
BOX_RANGE_SHARE = 0.1
"""Standard deviation of its range then: tilt and the roll of a board hide in the boxes' sizes."""


def localise_pnp(
    color_rgb: NDArray[np.uint8],
    depth_units: NDArray[np.uint16] | None,
    camera: RgbdCamera,
    candidate: Candidate,
    target: Target,
    up_camera: Array | None = None,
) -> Localisation | Refusal:
    """Where one candidate's target is, by points; or why it is not known.

    Args:
        color_rgb: (H, W, 3) as ``camera.color`` has it.
        depth_units: (h, w) raw depth as ``camera.depth`` has it, 0 for none; None without depth.
        camera: The rig.
        candidate: Boxes in the colour picture, and the labelled points that the net gave.
        target: What it is, with discs or ``points``.
        up_camera: (3,) the world's up in the camera frame, any length, if known: tells which edge
            of a bullseye's board is the upper one. Labelled points need no such help.

    Returns:
        The pose, or a ``Refusal``; nothing that a camera or a detector can send makes it raise.
    """
    view = _checked(color_rgb, depth_units, camera, candidate, target, up_camera)
    if isinstance(view, Refusal):
        return view
    evidence = evidence_of(view)
    if isinstance(evidence, Refusal):
        return evidence
    return _located(view, evidence, depth_units)


def _checked(
    color_rgb: NDArray[np.uint8],
    depth_units: NDArray[np.uint16] | None,
    camera: RgbdCamera,
    candidate: Candidate,
    target: Target,
    up_camera: Array | None,
) -> View | Refusal:
    if not fits_camera(color_rgb, depth_units, camera, up_camera):
        return Refusal.BAD_INPUT
    boxes = {k: box for k, box in candidate.boxes.items() if _in_picture(box, camera.color)}
    if not boxes:
        return Refusal.BAD_BOX
    return View(color_rgb, camera, replace(candidate, boxes=boxes), target, usable_up(up_camera))


def _in_picture(box: Box, intrinsics: CameraIntrinsics) -> bool:
    sides = (box.x0, box.y0, box.x1, box.y1)
    if not all(math.isfinite(s) and abs(s) <= MAX_COORDINATE_PX for s in sides):
        return False
    width = min(box.x1, intrinsics.width - 0.5) - max(box.x0, -0.5)
    return width >= 1 and min(box.y1, intrinsics.height - 0.5) - max(box.y0, -0.5) >= 1


def _located(
    view: View, evidence: PnpEvidence, depth_units: NDArray[np.uint16] | None
) -> Localisation | Refusal:
    """The fold, the depth's say, and the covariance."""
    alone = _without_plane(evidence)
    fits = [fit_pose(evidence.measured, start, prior=alone) for start in evidence.starts]
    folds = sorted(
        (fit for fit in fits if fit is not None and _faces(fit)), key=lambda fit: fit.cost
    )
    if not folds:
        return Refusal.BEHIND_CAMERA
    best = folds[0]
    others = [fold for fold in folds[1:] if angle(fold.normal, best.normal) > SAME_FOLD_RAD]
    other = others[0] if others else None
    depth = None if depth_units is None else _board_plane(depth_units, view, evidence, best)
    range_plane = None
    if depth is not None:
        range_plane = depth.plane.range_along(best.translation)
        gross = GROSS_RATIO if evidence.tilt_known else GROSS_BOX_RATIO
        if not 1 / gross < range_plane / length(best.translation) < gross:
            return Refusal.INCONSISTENT
        fused = _with_plane(evidence, [fold for fold in (best, other) if fold], depth.plane)
        if fused is not None:
            kept, left = (best, other) if fused.fold is best else (other, best)
            return _concluded(view, evidence, fused.fit, kept, left, depth, fused=True)
    return _concluded(view, evidence, best, best, other, depth, fused=False)


def _without_plane(evidence: PnpEvidence) -> Array | None:
    """The prior (6, 6) where no plane helps: of boxes the tilt has four answers or more."""
    if evidence.tilt_known or evidence.prior is None:
        return evidence.prior
    normal = evidence.starts[0].rotation[:, 0]
    pinned = evidence.prior.copy()
    pinned[3:, 3:] += (np.eye(3) - np.outer(normal, normal)) / PINNED_RAD**2
    return pinned


@dataclass(frozen=True, slots=True, eq=False)
class _Fused:
    fit: PnpFit
    fold: PnpFit
    """The picture's own fit that it began with."""


def _with_plane(
    evidence: PnpEvidence, folds: list[PnpFit], plane: InverseDepthPlane
) -> _Fused | None:
    """The fold that loses least when it has to agree with the plane; None: past the gate, both."""
    least, best = math.inf, None
    for fold in folds:
        if fold.cost >= least:
            continue  # with the plane it can only lose more
        fit = fit_pose(evidence.measured, fold.pose, plane, prior=evidence.prior)
        if fit is None or not _faces(fit):
            continue
        away, _ = plane_error(plane, fit.translation, fit.normal)
        cost = fit.cost + float(away @ plane.information @ away)
        if cost < least:
            least, best = cost, _Fused(fit, fold)
    if best is None or least - best.fold.cost > GATE:
        return None
    return best


def _concluded(
    view: View,
    evidence: PnpEvidence,
    fit: PnpFit,
    fold: PnpFit | None,
    other: PnpFit | None,
    depth: BoardPlane | None,
    *,
    fused: bool,
) -> Localisation | Refusal:
    """Add the covariance of everything that is not sure."""
    assert fold is not None, "one of the folds was chosen"
    center, normal = fit.translation, fit.normal
    if angle(normal, -unit(center)) > MAX_TILT_RAD:
        return Refusal.GRAZING
    information = fit.information
    if fused and depth is not None:
        _, by_pose = plane_error(depth.plane, center, normal)
        information = information + by_pose.T @ depth.plane.information @ by_pose
    covariance = covariance_from_information(information, normal, center, UNKNOWN_SIGMA_RAD)
    about_normal = np.concatenate([np.zeros(3), evidence.roll_sigma_rad * normal])
    covariance = widened(covariance, about_normal)
    if not fused and not evidence.tilt_known:
        covariance = covariance + _unknown_tilt(fit)
    share = 0.0
    if other is not None and not fused:
        share = doubt(other.cost - fold.cost, fold.normal, other.normal)
    if other is not None and share > 0:
        covariance = widened(covariance, pose_offset(fit.pose, other.pose), share)
    range_plane = None if depth is None else depth.plane.range_along(fold.translation)
    contradicts = depth is not None and not fused
    if contradicts and range_plane is not None:
        offset = np.zeros(6)
        offset[:3] = center * (range_plane / length(center) - 1)
        covariance = widened(covariance, offset)
    kept = fit.errors[fit.weights > 0]
    return Localisation(
        camera_from_target=fit.pose,
        covariance=floored(covariance),
        method=Method.PNP,
        roll_source=evidence.roll,
        alternative=None if other is None else other.pose,
        ambiguous=share > 0,
        range_ellipse_m=length(fold.translation),
        range_plane_m=range_plane,
        ellipse_rms_px=float(np.sqrt(np.square(kept).mean())),
        ellipse_points=evidence.used,
        plane_inliers=0 if depth is None else depth.plane.inliers,
        plane_rms_m=None if depth is None else depth.rms_m,
        depth_contradicts=contradicts,
    )


def _unknown_tilt(fit: PnpFit) -> Array:
    """What a board adds to the covariance (6, 6) that is only taken to face the camera."""
    more = np.zeros((6, 6))
    more[:3, :3] = BOX_RANGE_SHARE**2 * np.outer(fit.translation, fit.translation)
    about_normal = np.outer(fit.normal, fit.normal)
    more[3:, 3:] = BOX_TILT_SIGMA_RAD**2 * (np.eye(3) - about_normal)
    # two tilts one after the other turn the board as well
    more[3:, 3:] += (BOX_TILT_SIGMA_RAD**2 / 2) ** 2 * about_normal
    return more


def _board_plane(
    depth_units: NDArray[np.uint16], view: View, evidence: PnpEvidence, fit: PnpFit
) -> BoardPlane | None:
    """The plane of the point cloud, cropped to the board as the picture alone has it."""
    crop = _on_board if evidence.tilt_known else _in_disc
    return board_plane(crop(depth_units, view, fit))


def _on_board(depth_units: NDArray[np.uint16], view: View, fit: PnpFit) -> Array:
    """Depth points (N, 3) on the board of a pose."""
    half = BOARD_SHARE * view.target.board_side_m / 2
    rim = fit.pose @ np.column_stack([np.zeros(4), corner_places(2 * half)])
    uv = project(rim, view.camera.color)
    if not np.isfinite(uv).all():
        return np.empty((0, 3))
    (x0, y0), (x1, y1) = uv.min(axis=0).tolist(), uv.max(axis=0).tolist()
    points = depth_points_in_box(depth_units, view.camera, Box(x0, y0, x1, y1, 0.0)).points
    if not len(points):
        return points
    # by the ray and not by the point, whose depth is what is to be judged
    rays = points / points[:, 2:]
    stretch = float(fit.normal @ fit.translation) / np.minimum(rays @ fit.normal, -1e-6)
    on_board = (rays * stretch[:, None] - fit.translation) @ fit.rotation[:, 1:]
    return np.asarray(points[np.abs(on_board).max(axis=1) < half])


def _in_disc(depth_units: NDArray[np.uint16], view: View, fit: PnpFit) -> Array:
    """Depth points (N, 3) in the ellipse in the box of a disc: nothing else tells its tilt."""
    disc = box_guesses(view.candidate, view.target, view.camera.color)[0].disc
    return depth_points_in_ellipse(depth_units, view.camera, *disc)


def _faces(fit: PnpFit) -> bool:
    return float(fit.normal @ fit.translation) < 0
