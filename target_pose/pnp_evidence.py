"""What a picture gives for a pose by points: labelled ones, a board's corners, sides of boxes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from target_pose.box_guess import BORDER_PX, box_guesses
from target_pose.candidate import Candidate
from target_pose.circle_edges import printed_circles
from target_pose.circles import find_circle
from target_pose.conic import CirclePose
from target_pose.given import MIN_DISC_PX, usable_guesses
from target_pose.lens import rays_from_pixels
from target_pose.localisation import Refusal, RollSource
from target_pose.localise import BOX_TILT_SIGMA_RAD
from target_pose.pnp_boxes import measure_boxes
from target_pose.pnp_corners import Corners, corner_places, measure_corners
from target_pose.pnp_fit import Measurements, Predict, predict_points
from target_pose.pnp_points import SeenPoints, fit_points, seen_points
from target_pose.pnp_solve import planar_poses
from target_pose.roll import (
    ASSUMED_SIGMA_RAD,
    EDGE_FLOOR_RAD,
    find_roll,
    hinted_roll,
    rolled_pose,
)
from target_pose.target import Target
from target_pose.vectors import unit

Array: TypeAlias = NDArray[np.float64]

PASSES = 2
"""The edges are looked for where the rough outline has them, then where their corners do ..."""
SETTLED_PX = 1.0
"""... if that is farther off than this: well inside of every profile."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One candidate's picture, checked."""

    color_rgb: NDArray[np.uint8]  # (H, W, 3)
    camera: RgbdCamera
    candidate: Candidate
    target: Target
    up_camera: Array | None  # (3,)


@dataclass(frozen=True, slots=True, eq=False)
class PnpEvidence:
    """What the picture gives, before the depth is asked."""

    measured: Measurements
    starts: list[Pose]
    """Near every pose that it may be."""
    used: int
    """Points, or points of edges."""
    roll: RollSource
    roll_sigma_rad: float
    """What else makes the roll unsure."""
    prior: Array | None = None  # (6, 6)
    """Information about the start, for what the measurements do not show."""
    tilt_known: bool = True
    """The measurements tell the tilt, but for the fold; else it is the start's without a plane."""


def evidence_of(view: View) -> PnpEvidence | Refusal:
    """The best that the picture has to offer, by the ladder at the top of this file."""
    points = seen_points(view.candidate.points, view.target.points, view.camera.color, BORDER_PX)
    if isinstance(points, SeenPoints):
        return _by_points(points)
    if points is not Refusal.NO_EVIDENCE or not view.target.discs:
        return points
    guesses = usable_guesses(view.candidate, view.target, view.camera.color)
    if isinstance(guesses, Refusal):
        return guesses
    return _by_corners(view) or _by_boxes(view) or Refusal.NO_EVIDENCE


def _by_points(points: SeenPoints) -> PnpEvidence | Refusal:
    fitted = fit_points(points, MIN_DISC_PX)
    if isinstance(fitted, Refusal):
        return fitted
    return PnpEvidence(fitted.measured, fitted.poses, fitted.used, RollSource.POINTS, 0.0)


def _by_corners(view: View) -> PnpEvidence | None:
    """The corners of a bullseye's board."""
    intrinsics, target = view.camera.color, view.target
    image = np.asarray(cv2.cvtColor(view.color_rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    guesses = box_guesses(view.candidate, target, intrinsics)
    rough = find_circle(image, intrinsics, printed_circles(target)[0], guesses)
    if rough is None:
        return None
    for fold in rough.folds:
        roll = find_roll(image, intrinsics, fold, target, view.up_camera)
        if roll.source is not RollSource.EDGES:
            continue
        found = _corners_near(image, intrinsics, target, rolled_pose(fold, roll.up))
        if found is None:
            continue
        corners, starts, predict = found
        hint = hinted_roll(
            CirclePose(starts[0].translation, starts[0].rotation[:, 0]), view.up_camera
        )
        sure_of_upper = hint.sigma_rad <= ASSUMED_SIGMA_RAD
        information = np.asarray(np.linalg.inv(corners.covariance))
        measured = Measurements(corners.pixels.ravel(), information, predict)
        sigma = EDGE_FLOOR_RAD if sure_of_upper else math.pi / 4
        return PnpEvidence(measured, starts, corners.profiles, RollSource.EDGES, sigma)
    return None


def _corners_near(
    image: NDArray[np.uint8], intrinsics: CameraIntrinsics, target: Target, start: Pose
) -> tuple[Corners, list[Pose], Predict] | None:
    """The corners about where a pose has them, the poses that they have, and their prediction."""
    places = corner_places(target.board_side_m)
    focal = np.array([intrinsics.fx, intrinsics.fy])
    predict = predict_points(places, focal)
    found = None
    for _ in range(PASSES):
        corners = measure_corners(image, intrinsics, start, target)
        poses = [] if corners is None else planar_poses(places, corners.pixels, focal)
        if corners is None or not poses:
            return None
        found = corners, poses, predict
        expected = predict(start.translation, start.rotation, 0.0)
        start = poses[0]
        if expected is None:
            continue
        if np.abs(expected.values - corners.pixels.ravel()).max() < SETTLED_PX:
            break
    return found


def _by_boxes(view: View) -> PnpEvidence | None:
    """The sides of a bullseye's boxes; what they do not show is taken to face the camera."""
    intrinsics, target = view.camera.color, view.target
    measured = measure_boxes(view.candidate, target, intrinsics)
    if measured is None:
        return None
    guess = box_guesses(view.candidate, target, intrinsics)[0]
    ray = np.append(rays_from_pixels(np.array([guess.disc.center_px]), intrinsics)[0], 1.0)
    focal = math.sqrt(intrinsics.fx * intrinsics.fy)
    board = CirclePose(unit(ray) * target.discs[0].diameter_m * focal / guess.width_px, -unit(ray))
    roll = hinted_roll(board, view.up_camera)
    about_normal = np.outer(board.normal, board.normal)
    prior = np.zeros((6, 6))
    prior[3:, 3:] = (np.eye(3) - about_normal) / BOX_TILT_SIGMA_RAD**2
    prior[3:, 3:] += about_normal / roll.sigma_rad**2
    starts = [rolled_pose(board, roll.up)]
    return PnpEvidence(
        measured, starts, len(measured.values), roll.source, 0.0, prior, tilt_known=False
    )
