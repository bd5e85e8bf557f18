"""From a candidate's boxes to the target's pose: a ladder from the best evidence to the weakest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from target_pose.align import depth_points_in_box, depth_points_in_ellipse
from target_pose.appearance_fit import AppearanceFit
from target_pose.box_guess import BoxGuess
from target_pose.candidate import Box, Candidate
from target_pose.circle_edges import printed_circles
from target_pose.circles import PoseFit, RoughCircle, SeenFold, find_circle, fit_fold
from target_pose.conic import CirclePose, other_fold
from target_pose.covariance import (
    covariance_along,
    covariance_from_information,
    floored,
    pose_offset,
    widened,
)
from target_pose.fusion import CircleFit, plane_error
from target_pose.given import fits_camera, usable_guesses, usable_up
from target_pose.lens import project, rays_from_pixels
from target_pose.localisation import Evidence, Localisation, Method, Refusal
from target_pose.plane import BoardPlane, InverseDepthPlane, board_plane
from target_pose.roll import Roll, find_roll, hinted_roll, rolled_pose
from target_pose.target import Target
from target_pose.vectors import angle, cross, length, orthogonal_to, unit

Array: TypeAlias = NDArray[np.float64]

MAX_TILT_RAD = math.radians(72.0)
"""Past it the ellipse's minor axis, and with it tilt and range, are lost in the blur."""
BOARD_SHARE = 0.9
"""Part of the board's half side within which depth is taken: its rim mixes with what is behind."""
GATE = 25.0
"""Chi square, three degrees of freedom, past which plane and circles contradict each other. The
99.9 % point is 16.3; the noise of neither is quite Gaussian."""
GROSS_RATIO = 1.15
"""Ratio of the two ranges past which one of them must be a blunder."""
GROSS_BOX_RATIO = 1.7
"""The same for the range after a box's size: a board rolled by 45 degrees has a box 1.41 wider."""
SURE_FOLD = 16.0
"""By how much chi square must tell the folds apart: a model's errors are not only noise."""
LEAST_DOUBT = 9.0
"""Chi square that the covariance believes at most, where the folds are not told apart."""
PLANE_DECIDES = 25.0
"""By how much the plane alone must tell them apart, so that the other one need not be looked at."""
SAME_FOLD_RAD = math.radians(3.0)
BOX_SIZE_SHARE = 0.03
"""Standard deviation of a box's sides and centre over its size: a detector's regression."""
BOX_SIZE_PX = 1.5
BOX_TILT_SIGMA_RAD = math.radians(35.0)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """One candidate's picture, checked."""

    image: NDArray[np.uint8]  # (H, W), grey
    camera: RgbdCamera
    target: Target
    guesses: list[BoxGuess]
    up_camera: Array | None  # (3,)


def localise(
    color_rgb: NDArray[np.uint8],
    depth_units: NDArray[np.uint16] | None,
    camera: RgbdCamera,
    candidate: Candidate,
    target: Target,
    up_camera: Array | None = None,
) -> Localisation | Refusal:
    """Where one candidate's target is, with what certainty and from what; or why it is not known.

    Args:
        color_rgb: (H, W, 3) as ``camera.color`` has it.
        depth_units: (h, w) raw depth as ``camera.depth`` has it, 0 for none; None without depth.
        camera: The rig.
        candidate: Boxes in the colour picture.
        target: What was printed.
        up_camera: (3,) the world's up in the camera frame, any length, if known: fixes the roll.

    Returns:
        The pose, or a ``Refusal``; nothing that a camera or a detector can send makes it raise.
    """
    view = _checked(color_rgb, depth_units, camera, candidate, target, up_camera)
    if isinstance(view, Refusal):
        return view
    circles = printed_circles(target)
    rough = find_circle(view.image, camera.color, circles[0], view.guesses)
    outline = None if rough is None else rough.folds[0]
    depth = None if depth_units is None else _board_plane(depth_units, view, outline)
    near = None if rough is None else _near_fold(view, rough, depth)
    if rough is None or near is None:
        return _by_depth(view, depth) if depth is not None else _by_box(view)
    if depth is None:
        return _by_ellipse(view, near)
    return _fused(view, near, depth)


def _checked(
    color_rgb: NDArray[np.uint8],
    depth_units: NDArray[np.uint16] | None,
    camera: RgbdCamera,
    candidate: Candidate,
    target: Target,
    up_camera: Array | None,
) -> _View | Refusal:
    if not fits_camera(color_rgb, depth_units, camera, up_camera):
        return Refusal.BAD_INPUT
    if not target.discs:
        return Refusal.NO_EVIDENCE
    guesses = usable_guesses(candidate, target, camera.color)
    if isinstance(guesses, Refusal):
        return guesses
    image = np.asarray(cv2.cvtColor(color_rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    return _View(image, camera, target, guesses, usable_up(up_camera))


def _board_plane(
    depth_units: NDArray[np.uint16], view: _View, board: CirclePose | None
) -> BoardPlane | None:
    """The plane of the depth on the board, or within the first guess where no board is known."""
    if board is None:
        disc = view.guesses[0].disc
        return board_plane(depth_points_in_ellipse(depth_units, view.camera, *disc))
    box = _board_box(view, board)
    if box is None:
        return None
    points = depth_points_in_box(depth_units, view.camera, box).points
    if not len(points):
        return None
    # by the ray and not by the point, whose depth is what is to be judged
    rays = points / points[:, 2:]
    stretch = float(board.normal @ board.center) / np.minimum(rays @ board.normal, -1e-6)
    off = np.linalg.norm(rays * stretch[:, None] - board.center, axis=1)
    return board_plane(points[off < BOARD_SHARE * view.target.board_side_m / 2])


def _board_box(view: _View, board: CirclePose) -> Box | None:
    """The box of the largest circle on the board."""
    right, up = orthogonal_to(board.normal)
    angle = np.arange(24) * (2 * math.pi / 24)
    rim = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up
    uv = project(board.center + BOARD_SHARE * view.target.board_side_m / 2 * rim, view.camera.color)
    if not np.isfinite(uv).all():
        return None
    (x0, y0), (x1, y1) = uv.min(axis=0), uv.max(axis=0)
    return Box(float(x0), float(y0), float(x1), float(y1), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _NearFold:
    """The circles' pose without any depth in the fold that the depth prefers, if there is any."""

    seen: SeenFold
    rough: RoughCircle
    other: CirclePose
    """Start of the other fold."""


def _near_fold(view: _View, rough: RoughCircle, depth: BoardPlane | None) -> _NearFold | None:
    """The fold nearer to the plane's normal; the other where that is not seen and may be wrong."""
    one, two = rough.folds
    if depth is not None:
        normal = depth.plane.normal
        if two.normal @ normal > one.normal @ normal:
            one, two = two, one
    ways = [(one, two), (two, one)]
    if depth is not None:
        behind = _leaning_cost(depth.plane, two) - _leaning_cost(depth.plane, one)
        if behind > PLANE_DECIDES:
            # what is not seen in the fold that it must be is not there in the other
            ways.pop()
    for start, other in ways:
        seen = _fit_fold(view, rough, start)
        if seen is not None:
            return _NearFold(seen, rough, other)
    return None


def _fit_fold(
    view: _View, rough: RoughCircle, start: CirclePose, like: SeenFold | None = None
) -> SeenFold | None:
    camera = view.camera.color
    return fit_fold(view.image, camera, view.target, rough, start, view.up_camera, like)


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    """One fold's circles with the plane."""

    seen: SeenFold
    fused: PoseFit
    strain: float
    """Chi square by which plane and circles lose when they have to share one pose."""


def _joined(view: _View, seen: SeenFold | None, plane: InverseDepthPlane) -> _Joint | None:
    fused = None if seen is None else seen.fit_with_plane(view.camera.color, plane)
    if seen is None or fused is None:
        return None
    return _Joint(seen, fused, _strain(fused, seen.fit, plane))


def _fused(view: _View, near: _NearFold, depth: BoardPlane) -> Localisation | Refusal:
    """Circles and plane together, if they agree; else the circles, or a refusal.

    The plane's normal picks the fold where it is sure; where it is not, so do both together.
    """
    plane, free = depth.plane, near.seen.fit
    range_ellipse = length(free.pose.center)
    range_plane = plane.range_along(free.pose.center)
    if not 1 / GROSS_RATIO < range_plane / range_ellipse < GROSS_RATIO:
        return Refusal.INCONSISTENT
    best = _joined(view, near.seen, plane)
    alternative = other_fold(free.pose, view.target.discs[0].diameter_m / 2)
    share = 0.0
    behind = _plane_cost(plane, alternative) - _plane_cost(plane, free.pose)
    apart = angle(free.pose.normal, alternative.normal) > SAME_FOLD_RAD
    if apart and behind < PLANE_DECIDES:
        rival = _joined(view, _fit_fold(view, near.rough, near.other, near.seen), plane)
        best, other, share = _likelier(best, rival)
        if other is not None:
            alternative = other.fused.pose
    if best is None or best.strain > GATE:
        # circles that were never seen as an outline do not stand against the depth
        return _by_ellipse(view, near, depth) if near.rough.outlined else _by_depth(view, depth)
    return _concluded(
        view,
        best.fused,
        Method.FUSED,
        alternative=alternative,
        alternative_share=share,
        ranges=(length(best.seen.fit.pose.center), range_plane),
        depth=depth,
        alone=best.seen.fit,
    )


def _likelier(one: _Joint | None, two: _Joint | None) -> tuple[_Joint | None, _Joint | None, float]:
    """The fold that picture and plane together prefer, the other, and that one's probability."""
    if one is None or two is None:
        return one or two, None, 0.0
    sigma = min(one.seen.fit.sigma, two.seen.fit.sigma)
    behind = (two.seen.cost(sigma) + two.strain) - (one.seen.cost(sigma) + one.strain)
    if behind < 0:
        one, two, behind = two, one, -behind
    return one, two, doubt(behind, one.fused.pose.normal, two.fused.pose.normal)


def doubt(behind: float, best_normal: Array, other_normal: Array) -> float:
    """Probability of the other fold, by chi square; 0 where they are the same or told apart."""
    if angle(best_normal, other_normal) <= SAME_FOLD_RAD or behind >= SURE_FOLD:
        return 0.0
    return 1 / (1 + math.exp(min(behind, LEAST_DOUBT) / 2))


def _plane_cost(plane: InverseDepthPlane, board: CirclePose) -> float:
    """Squared standard deviations by which a pose misses the plane."""
    error, _ = plane_error(plane, *board)
    return float(error @ plane.information @ error)


def _leaning_cost(plane: InverseDepthPlane, board: CirclePose) -> float:
    """The same of its normal alone: the board is taken to the plane's range first."""
    z = plane.depth_along(board.center / board.center[2])
    if not math.isfinite(z):
        return math.inf
    return _plane_cost(plane, CirclePose(board.center * (z / board.center[2]), board.normal))


def _strain(fused: PoseFit, free: PoseFit, plane: InverseDepthPlane) -> float:
    """Chi square by which plane and circles lose when they have to share one pose."""
    error, jacobian = plane_error(plane, *fused.pose)
    turn = cross(free.pose.normal, fused.pose.normal)
    moved = np.concatenate([fused.pose.center - free.pose.center, turn])
    # a frontal circle's tilt costs nothing to first order, but it does where it has been turned to
    without_plane = fused.information - jacobian.T @ plane.information @ jacobian
    lost = max(float(moved @ free.information @ moved), float(moved @ without_plane @ moved))
    return float(error @ plane.information @ error) + lost


def _by_ellipse(
    view: _View, near: _NearFold, contradicting: BoardPlane | None = None
) -> Localisation | Refusal:
    """The circles alone. Which fold it is, the inner circles tell where they are large enough."""
    first = near.seen
    best, alternative = first.fit, near.other
    share = 0.0
    second = _fit_fold(view, near.rough, near.other, near.seen)
    if second is not None:
        sigma = min(first.fit.sigma, second.fit.sigma)
        behind = second.cost(sigma) - first.cost(sigma)
        if contradicting is not None:
            # a plane at another range still knows which way the board leans
            plane = contradicting.plane
            behind += _leaning_cost(plane, second.fit.pose) - _leaning_cost(plane, first.fit.pose)
        best, alternative = first.fit, second.fit.pose
        if behind < 0:
            best, alternative = second.fit, first.fit.pose
        share = doubt(abs(behind), best.pose.normal, alternative.normal)
    range_ellipse = length(best.pose.center)
    range_plane = None
    if contradicting is not None:
        range_plane = contradicting.plane.range_along(best.pose.center)
    return _concluded(
        view,
        best,
        Method.ELLIPSE,
        alternative=alternative,
        alternative_share=share,
        ranges=(range_ellipse, range_plane),
        depth=contradicting,
    )


def _concluded(
    view: _View,
    fit: PoseFit,
    method: Method,
    *,
    alternative: CirclePose | None,
    ranges: tuple[float, float | None],
    depth: BoardPlane | None,
    alternative_share: float = 0.0,
    alone: PoseFit | None = None,
) -> Localisation | Refusal:
    """Add the roll, and the covariance of everything that is not sure."""
    if _tilt(fit.pose) > MAX_TILT_RAD:
        return Refusal.GRAZING
    roll = _roll(view, fit.pose)
    pose = rolled_pose(fit.pose, roll.up)
    covariance = covariance_from_information(
        fit.information, fit.pose.normal, fit.pose.center, roll.sigma_rad
    )
    other = None if alternative is None else rolled_pose(alternative, roll.up)
    if alternative is not None and alternative_share:
        # seen from the other fold, the same edges of the board mean another roll
        turned = _roll(view, alternative)
        other = rolled_pose(alternative, turned.up)
        covariance = widened(covariance, pose_offset(pose, other), alternative_share)
        about_normal = np.concatenate([np.zeros(3), turned.sigma_rad * alternative.normal])
        covariance = widened(covariance, about_normal, alternative_share)
    contradicts = depth is not None and method is Method.ELLIPSE
    if contradicts and ranges[1] is not None:
        offset = np.zeros(6)
        offset[:3] = fit.pose.center * (ranges[1] / ranges[0] - 1)
        covariance = widened(covariance, offset)
    used = int(np.count_nonzero(fit.inliers))
    return Localisation(
        camera_from_target=pose,
        covariance=floored(covariance),
        method=method,
        roll_source=roll.source,
        alternative=other,
        ambiguous=alternative_share > 0,
        range_ellipse_m=ranges[0],
        range_plane_m=ranges[1],
        ellipse_rms_px=fit.rms_px if isinstance(fit, CircleFit) else None,
        ellipse_points=used if isinstance(fit, CircleFit) else 0,
        picture_rms_levels=fit.rms_levels if isinstance(fit, AppearanceFit) else None,
        picture_points=used if isinstance(fit, AppearanceFit) else 0,
        plane_inliers=0 if depth is None else depth.plane.inliers,
        plane_rms_m=None if depth is None else depth.rms_m,
        depth_contradicts=contradicts,
        evidence=Evidence(fit, alone or fit, None if depth is None else depth.plane),
    )


def _by_depth(view: _View, depth: BoardPlane) -> Localisation | Refusal:
    """The plane, where the box's bearing meets it."""
    guess = view.guesses[0]
    ray = _ray(view.camera.color, guess)
    z = depth.plane.depth_along(ray)
    if not math.isfinite(z):
        return Refusal.BEHIND_CAMERA
    board = CirclePose(ray * z, depth.plane.normal)
    if _tilt(board) > MAX_TILT_RAD:
        return Refusal.GRAZING
    range_m = length(board.center)
    if guess.sized:
        ratio = range_m / _box_range(view, guess)
        if not 1 / GROSS_BOX_RATIO < ratio < GROSS_BOX_RATIO:
            return Refusal.INCONSISTENT
    roll = hinted_roll(board, view.up_camera)
    lateral = _box_sigma_px(guess) * range_m / _focal(view.camera.color)
    _, jacobian = plane_error(depth.plane, *board)
    # the plane fixes range and normal, the box the two directions across the line of sight
    line = board.center / range_m
    information = jacobian.T @ depth.plane.information @ jacobian
    information[:3, :3] += (np.eye(3) - np.outer(line, line)) / lateral**2
    return Localisation(
        camera_from_target=rolled_pose(board, roll.up),
        covariance=covariance_from_information(
            information, board.normal, board.center, roll.sigma_rad
        ),
        method=Method.DEPTH,
        roll_source=roll.source,
        range_plane_m=range_m,
        plane_inliers=depth.plane.inliers,
        plane_rms_m=depth.rms_m,
    )


def _by_box(view: _View) -> Localisation | Refusal:
    """Bearing and size of the box; the board is taken to face the camera."""
    sized = [guess for guess in view.guesses if guess.sized]
    if not sized:
        return Refusal.NO_EVIDENCE
    guess = sized[0]
    ray = _ray(view.camera.color, guess)
    line = unit(ray)
    range_m = _box_range(view, guess)
    board = CirclePose(line * range_m, -line)
    roll = hinted_roll(board, view.up_camera)
    sigma_px = _box_sigma_px(guess)
    covariance = covariance_along(
        board.center,
        board.normal,
        # a rolled board's box is up to 1.41 too wide; tilt hides in perspective
        range_sigma_m=range_m * math.hypot(0.1, 2 * sigma_px / guess.width_px),
        lateral_sigma_m=sigma_px * range_m / _focal(view.camera.color),
        tilt_sigma_rad=BOX_TILT_SIGMA_RAD,
        roll_sigma_rad=roll.sigma_rad,
    )
    return Localisation(
        camera_from_target=rolled_pose(board, roll.up),
        covariance=covariance,
        method=Method.BOX,
        roll_source=roll.source,
    )


def _roll(view: _View, board: CirclePose) -> Roll:
    return find_roll(view.image, view.camera.color, board, view.target, view.up_camera)


def _tilt(board: CirclePose) -> float:
    """Angle [rad] between the board's normal and the line of sight."""
    return angle(board.normal, -unit(board.center))


def _ray(intrinsics: CameraIntrinsics, guess: BoxGuess) -> Array:
    xy = rays_from_pixels(np.array([guess.disc.center_px]), intrinsics)[0]
    return np.array([xy[0], xy[1], 1.0])


def _focal(intrinsics: CameraIntrinsics) -> float:
    return math.sqrt(intrinsics.fx * intrinsics.fy)


def _box_range(view: _View, guess: BoxGuess) -> float:
    return view.target.discs[0].diameter_m * _focal(view.camera.color) / guess.width_px


def _box_sigma_px(guess: BoxGuess) -> float:
    sigma = math.hypot(BOX_SIZE_PX, BOX_SIZE_SHARE * guess.width_px)
    # a completed box hides its centre, not only its edges
    return sigma + (0.25 * guess.width_px if guess.cut else 0.0)
