"""From a box to the printed circles: found, measured, and fitted in both folds."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from target_pose.appearance import LEAST_BLUR_PX, Board, Look
from target_pose.appearance_fit import AppearanceFit, Patch, cut_patch, fit_appearance
from target_pose.box_guess import BoxGuess
from target_pose.circle_edges import (
    CircleEdges,
    PrintedCircle,
    circles_worth_measuring,
    measure_edges,
    printed_circles,
)
from target_pose.conic import CirclePose, circle_poses
from target_pose.disc_finder import find_disc
from target_pose.ellipse import fit_ellipse
from target_pose.fusion import OUTLIER_COST, CircleFit, fit_circles
from target_pose.lens import rays_from_pixels
from target_pose.plane import InverseDepthPlane
from target_pose.roll import find_roll
from target_pose.target import Shade, Target
from target_pose.vectors import length

Array: TypeAlias = NDArray[np.float64]

MIN_STEP_PX, MAX_STEP_PX = 0.4, 2.0
STEP_PER_BLUR = 0.45
"""Step of the profiles over the blur: eight steps each way hold the whole edge."""
MIN_INLIER_SHARE = 0.5
"""Of the edge points measured; the rest may be covered."""
MIN_POINTS = 16
MAX_RMS_PX = 0.6
MAX_RMS_SHARE = 0.01
"""Root mean square error over the disc's radius past which the outline is no circle's."""


SMALL_PX = 48.0
"""Width of the outer disc under which all pixels are fitted at once, and not the edges."""
MIN_PIXEL_SHARE = 0.7
"""Of the pixels on the board that must look as they should; the rest may be covered."""
MIN_EXPLAINED = 0.6
"""Share of the picture's variance on the board that the pose has to explain; the rest is noise."""
MAX_PRIOR_COST = 40.0
"""Chi square of light, cut and tone past which they only make up for a wrong pose."""
MIN_CONTRAST = 6.0
"""Of the print, in grey values."""


class RoughCircle(NamedTuple):
    """The outer disc before its pose is refined."""

    folds: tuple[CirclePose, CirclePose]
    step_px: float
    """Profile step that fits the picture's blur."""
    blur_px: float
    """Standard deviation of the blur, as far as the search shows it."""
    outlined: bool = True
    """The outline was seen; else a box alone says where it is."""


class SeenEdges(NamedTuple):
    """The circles' edges where one fold predicts them, and the pose there that fits them best."""

    edges: CircleEdges
    fit: CircleFit
    radius_px: float
    """Of the outer circle."""

    def cost(self, sigma: float) -> float:
        """Squared errors in standard deviations; an edge that is not there counts as an outlier."""
        return self.fit.cost(sigma) + OUTLIER_COST * self.edges.missing

    def fit_with_plane(
        self, intrinsics: CameraIntrinsics, plane: InverseDepthPlane
    ) -> CircleFit | None:
        """The pose that fits edges and plane together; None if not the edges any more."""
        fit = fit_circles(self.edges, intrinsics, self.fit.pose, plane)
        return fit if fit is not None and _round(fit, self.radius_px) else None


class SeenBoard(NamedTuple):
    """A small target's pixels, and the pose near one fold under which it looks like them."""

    patch: Patch
    board: Board
    fit: AppearanceFit

    def cost(self, sigma: float) -> float:
        """Squared errors in standard deviations."""
        return self.fit.cost(sigma)

    def fit_with_plane(
        self, intrinsics: CameraIntrinsics, plane: InverseDepthPlane
    ) -> AppearanceFit | None:
        """The pose that fits pixels and plane together; None if not the pixels any more."""
        fit = fit_appearance(self.patch, self.board, self.fit.look, plane, lit=True)
        return fit if fit is not None and _looks_right(fit) else None


SeenFold: TypeAlias = SeenEdges | SeenBoard
PoseFit: TypeAlias = CircleFit | AppearanceFit


def find_circle(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    outer: PrintedCircle,
    guesses: list[BoxGuess],
) -> RoughCircle | None:
    """Find the outer disc by the first guess under which it shows."""
    for guess in guesses:
        outline = find_disc(image, guess.disc, outer.dark_inside)
        if outline is None:
            continue
        folds = _poses(rays_from_pixels(outline.uv_px, intrinsics), outer.radius_m)
        if folds is None:
            continue
        blur = outline.blur_px if math.isfinite(outline.blur_px) else 1.0
        step_px = min(max(STEP_PER_BLUR * blur, MIN_STEP_PX), MAX_STEP_PX)
        return RoughCircle(folds, step_px, blur)
    return _guessed(intrinsics, outer, guesses)


def _guessed(
    intrinsics: CameraIntrinsics, outer: PrintedCircle, guesses: list[BoxGuess]
) -> RoughCircle | None:
    """The disc as a whole box has it: upright and as wide, where its outline is lost in grain."""
    for guess in guesses:
        if guess.cut:
            continue
        angle = np.arange(16) * (2 * math.pi / 16)
        rim = np.stack([np.cos(angle), np.sin(angle)], axis=1) * guess.disc.semi_axes_px
        folds = _poses(rays_from_pixels(guess.disc.center_px + rim, intrinsics), outer.radius_m)
        if folds is not None:
            return RoughCircle(folds, STEP_PER_BLUR, 1.0, outlined=False)
    return None


def fit_fold(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    target: Target,
    rough: RoughCircle,
    fold: CirclePose,
    up_camera: Array | None = None,
    like: SeenFold | None = None,
) -> SeenFold | None:
    """Fit the pose near one of the rough folds to what is seen there.

    A small target's edges run into one another: all its pixels are fitted. Of a larger one the
    edges are measured. Near the target the folds predict the inner circles in different places, so
    that each has to look for its own.

    Returns:
        The fit, or None if what is there is not the target.
    """
    circles = printed_circles(target)
    px_per_m = _px_per_m(intrinsics, rough.folds[0])
    patch = like.patch if isinstance(like, SeenBoard) else None
    if patch is not None or 2 * circles[0].radius_m * px_per_m < SMALL_PX:
        return _fit_board(image, intrinsics, target, rough, fold, up_camera, patch)
    worth = circles_worth_measuring(circles, px_per_m)
    edges = _fit_edges(image, intrinsics, worth, rough, fold) if rough.outlined else None
    if edges is not None or isinstance(like, SeenEdges):
        return edges
    # grain hides edges that all pixels together still show
    return _fit_board(image, intrinsics, target, rough, fold, up_camera)


def _fit_edges(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    circles: tuple[PrintedCircle, ...],
    rough: RoughCircle,
    fold: CirclePose,
) -> SeenEdges | None:
    edges = measure_edges(image, intrinsics, fold, circles, rough.step_px)
    if edges is None or len(edges.xy) < MIN_POINTS:
        return None
    radius_px = circles[0].radius_m * _px_per_m(intrinsics, rough.folds[0])
    fit = fit_circles(edges, intrinsics, fold)
    return SeenEdges(edges, fit, radius_px) if fit is not None and _round(fit, radius_px) else None


def _fit_board(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    target: Target,
    rough: RoughCircle,
    fold: CirclePose,
    up_camera: Array | None,
    patch: Patch | None = None,
) -> SeenBoard | None:
    board = Board(
        target.board_side_m / 2, printed_circles(target), target.board_shade is Shade.WHITE
    )
    up = find_roll(image, intrinsics, fold, target, up_camera).up
    blur_px = max(rough.blur_px, 2 * LEAST_BLUR_PX)
    start = Look(fold.center, fold.normal, up, blur_px2=blur_px**2)
    patch = patch or cut_patch(image, intrinsics, board, start)
    if patch is None:
        return None
    blur_px2 = max(start.blur_px2 / patch.bin_px**2, LEAST_BLUR_PX**2)
    fit = fit_appearance(patch, board, replace(start, blur_px2=blur_px2))
    return SeenBoard(patch, board, fit) if fit is not None and _looks_right(fit) else None


def _poses(xy: Array, radius_m: float) -> tuple[CirclePose, CirclePose] | None:
    real = np.isfinite(xy).all(axis=1)
    conic = fit_ellipse(xy[real])
    return None if conic is None else circle_poses(conic, radius_m)


def _px_per_m(intrinsics: CameraIntrinsics, pose: CirclePose) -> float:
    return math.sqrt(intrinsics.fx * intrinsics.fy) / length(pose.center)


def _round(fit: CircleFit, radius_px: float) -> bool:
    """The edge points lie on the circles of one pose."""
    many = np.count_nonzero(fit.inliers) >= max(MIN_POINTS, MIN_INLIER_SHARE * len(fit.inliers))
    return bool(many) and fit.rms_px <= max(MAX_RMS_PX, MAX_RMS_SHARE * radius_px)


def _looks_right(fit: AppearanceFit) -> bool:
    """The pixels show the print, in black on white."""
    many = np.count_nonzero(fit.inliers) >= MIN_PIXEL_SHARE * len(fit.inliers)
    shown = fit.contrast >= MIN_CONTRAST and fit.prior_cost <= MAX_PRIOR_COST
    return bool(many) and shown and min(fit.explained, fit.explained_inside) >= MIN_EXPLAINED
