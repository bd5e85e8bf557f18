"""The pose under which the board would look as it does: all pixels of a small target at once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from target_pose import appearance
from target_pose.appearance import (
    SRGB_TONE,
    Board,
    Focal,
    Look,
    Predicted,
    Raster,
    outside_px,
    predict,
)
from target_pose.conic import CirclePose
from target_pose.fusion import SIZE_SIGMA, TILT_DAMPING, plane_terms
from target_pose.lens import project, rays_from_pixels
from target_pose.plane import InverseDepthPlane
from target_pose.tukey import TUKEY, robust_sigma, tukey_weights
from target_pose.vectors import cross, length

Array: TypeAlias = NDArray[np.float64]

AROUND_PX = 2.0
"""How far beyond the board's rim pixels are looked at: the wall is taken to be plain there."""
MIN_SIDE_PX, MAX_SIDE_PX = 8, 64
"""Of the patch; of a larger one, several pixels are taken together."""
MIN_PIXELS = 60
NOISE_FLOOR = 0.8
"""Least standard deviation of a pixel [grey values] believed: rounding and JPEG."""
MODEL_ERROR = 0.06
"""Standard deviation of the prediction, over the contrast: steps drawn to first order, a point
spread that is not quite Gaussian, sharpening, scratches. Set by how rendered scenes err."""
MARGIN_SIGMA_M = 2e-3
"""How well a board is cut."""
STRETCH_SIGMA = 0.4
"""How far from round a blur may be, over its variance."""
TONE_SIGMA = 0.2
"""Of the tone curve's exponent: from a picture without any, 1, to more contrast than sRGB has."""
PEDESTAL_SIGMA = 8.0
"""[grey values]"""
VEIL_SIGMA = 0.1
"""Of what a cover mirrors, over the contrast in light."""
SATURATED = 250
"""Grey value from which on, and as near to zero, a pixel is at the end of its scale."""
DARKEST = 1e-4
"""Light that is coded as black."""
SHADE_SIGMA = 0.2
WALL_SIGMA = 0.5
"""Of how the wall's light slopes, over the light itself."""
ITERATIONS = 16
CONVERGED = 0.3
"""Gain in squared standard deviations that ends the search."""
MAX_TURN_RAD = 0.3
"""Of one step."""
HALVINGS = 4
INSIDE = 1.25
"""Radius, in those of the second circle, within which the inner circles are looked at."""
CELL_PX = 3
CELL_BORDER_LOSS = 1.3
"""What correlation across the cells' borders adds."""


class Patch(NamedTuple):
    """A board's part of the picture."""

    raster: Raster
    gray: Array  # (N,), as the camera coded it
    focal_px: Focal
    """Of the patch's raster, which is coarser than the picture's where the board is large."""
    bin_px: int
    """Pixels of the picture per one of the patch."""
    chosen: NDArray[np.bool_]  # (N,)
    """On the board and a little around it."""


@dataclass(frozen=True, slots=True, eq=False)
class AppearanceFit:
    """The pose, up to its roll, under which the picture of the board is the likeliest."""

    look: Look
    information: Array  # (6, 6)
    """Inverse covariance of (translation, rotation vector), camera frame; says nothing of roll."""
    errors: Array  # (N,)
    """Picture less prediction [grey values]."""
    noise: float
    """Standard deviation of the errors, with what the prediction may be off."""
    sigma: float
    """The same, larger by what neighbours that err together count for less."""
    inliers: NDArray[np.bool_]  # (N,)
    prior_cost: float
    """Of the nuisances, in squared standard deviations."""
    explained: float
    """Share of the picture's variance on the used pixels that the prediction has, at most 1."""
    explained_inside: float
    """The same of all pixels about the inner circles, which tell the target from other rings."""

    @property
    def pose(self) -> CirclePose:
        """Centre and normal."""
        return CirclePose(self.look.center, self.look.normal)

    @property
    def rms_levels(self) -> float:
        """Root mean square error of the inliers [grey values]."""
        return float(np.sqrt(np.square(self.errors[self.inliers]).mean()))

    @property
    def contrast(self) -> float:
        """Of white over black [grey values]."""
        return contrast_of(self.look)

    def cost(self, sigma: float) -> float:
        """Robust squared errors in standard deviations, and the nuisances'."""
        return _robust_cost(self.errors, sigma) + self.prior_cost


def contrast_of(look: Look) -> float:
    """Of white over black [grey values]."""
    white, black = coded(np.array([look.white, look.black]), look.tone)[0].tolist()
    return float(white - black)


def cut_patch(
    image: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    board: Board,
    look: Look,
) -> Patch | None:
    """The pixels of a board and a little around it; None if they are too few."""
    right = cross(look.up, look.normal)
    half = board.half_side_m
    corners = [look.center + half * (a * right + b * look.up) for a in (-1, 1) for b in (-1, 1)]
    uv = project(np.array(corners), intrinsics)
    if not np.isfinite(uv).all():
        return None
    height, width = image.shape
    around = AROUND_PX + 2 * math.sqrt(look.blur_px2)
    low, high = uv.min(axis=0) - around, uv.max(axis=0) + around
    bin_px = max(1, math.ceil(float((high - low).max()) / MAX_SIDE_PX))
    x0, y0 = (int(v) for v in np.clip(np.floor(low), 0, (width, height)))
    x1, y1 = (int(v) for v in np.clip(np.ceil(high) + 1, 0, (width, height)))
    w, h = (x1 - x0) // bin_px, (y1 - y0) // bin_px
    if min(w, h) < MIN_SIDE_PX:
        return None
    gray = image[y0 : y0 + h * bin_px, x0 : x0 + w * bin_px].astype(np.float64)
    if bin_px > 1:
        # light adds up, code values do not
        light = _light(gray, look.tone).reshape(h, bin_px, w, bin_px).mean(axis=(1, 3))
        gray = coded(light, look.tone)[0]
    middle = (bin_px - 1) / 2
    u, v = np.meshgrid(
        x0 + middle + bin_px * np.arange(w, dtype=np.float64),
        y0 + middle + bin_px * np.arange(h, dtype=np.float64),
    )
    xy = rays_from_pixels(np.stack([u.ravel(), v.ravel()], axis=1), intrinsics)
    if not np.isfinite(xy).all():
        return None
    rays = np.column_stack([xy, np.ones(len(xy))])
    x, y = np.meshgrid(np.linspace(-1, 1, w), np.linspace(-1, 1, h))
    focal_px = intrinsics.fx / bin_px, intrinsics.fy / bin_px
    raster = Raster(rays, x.ravel(), y.ravel(), (h, w))
    outside = outside_px(raster, focal_px, board, look)
    if outside is None:
        return None
    return Patch(raster, gray.ravel(), focal_px, bin_px, outside < AROUND_PX)


def fit_appearance(
    patch: Patch,
    board: Board,
    start: Look,
    plane: InverseDepthPlane | None = None,
    lit: bool = False,
) -> AppearanceFit | None:
    """Gauss-Newton on the grey values, with Tukey weights, and on the depth's plane.

    Unknowns are the pose, the light on board and wall, the blur, and nuisances with priors; the
    covariance is that of the pose with all others marginalised.

    Args:
        patch: What is seen.
        board: What is printed.
        start: Pose within a few pixels, blur in pixels of the patch, and light.
        plane: The depth's measurement of the board's plane, if any.
        lit: ``start`` has the light of an earlier fit; else it is found first.

    Returns:
        The fit, or None where it leaves the half-space in front of the camera, or where there is
        no board to be seen.
    """
    seen = predict(patch.raster, patch.focal_px, board, start)
    if seen is None:
        return None
    if np.count_nonzero(patch.chosen) < MIN_PIXELS:
        return None
    look = start
    if not lit:
        look = _lit(patch, seen, start)
        seen = predict(patch.raster, patch.focal_px, board, look)
    assert seen is not None
    prior = _prior(look)
    state = _State(patch, seen, look)
    for _ in range(ITERATIONS):
        following = _better(patch, board, (state, look), prior, plane)
        if following is None:
            break
        state, look, gain = following
        if gain < CONVERGED:
            break
    return _conclude(state, look, prior, plane, board)


def _better(
    patch: Patch,
    board: Board,
    at: tuple[_State, Look],
    prior: Array,
    plane: InverseDepthPlane | None,
) -> tuple[_State, Look, float] | None:
    """A step of Gauss and Newton, halved until it gains something, and its gain; None: no more."""
    state, look = at
    h, g = _normal_equations(state, look, prior, plane)
    h[appearance.TURN, appearance.TURN] += TILT_DAMPING * np.eye(3)
    h[appearance.CENTER, appearance.CENTER] += 1e-6 * np.eye(3)
    scale = np.sqrt(np.maximum(np.diagonal(h), 1e-12))
    step = -np.linalg.solve(h / np.outer(scale, scale) + 1e-9 * np.eye(len(h)), g / scale) / scale
    turn = length(np.asarray(step[appearance.TURN]))
    if turn > MAX_TURN_RAD:
        step *= MAX_TURN_RAD / turn
    if float(-(g @ step)) < CONVERGED:
        return None
    before = _cost(state, look, prior, plane, state.sigma)
    for _ in range(HALVINGS):
        following = look.moved(step)
        seen = predict(patch.raster, patch.focal_px, board, following)
        if seen is not None:
            trial = _State(patch, seen, following)
            gain = before - _cost(trial, following, prior, plane, state.sigma)
            if gain >= 0:
                return trial, following, gain
            if gain > -CONVERGED:
                return None
        step = step / 2
    return None


class _State:
    """Errors of a prediction and its derivative, in grey values, of the chosen pixels."""

    __slots__ = ("derivative", "errors", "gray", "open", "radius_m", "shape", "sigma", "where")

    def __init__(self, patch: Patch, seen: Predicted, look: Look) -> None:
        chosen = patch.chosen
        gray, by_light, by_tone = coded(seen.light[chosen], look.tone)
        self.gray = patch.gray[chosen]
        self.errors = gray + look.pedestal - self.gray
        self.derivative = seen.derivative[chosen] * by_light[:, None]
        self.derivative[:, appearance.TONE] = by_tone
        self.derivative[:, appearance.PEDESTAL] = 1.0
        # how much brighter than white or darker than black it would be, a picture does not say
        full = (self.gray >= SATURATED) & (self.errors > SATURATED - 255)
        empty = (self.gray <= 255 - SATURATED) & (self.errors < 255 - SATURATED)
        clipped = full | empty
        self.errors[clipped] = 0.0
        self.derivative[clipped] = 0.0
        self.open = ~clipped
        measured = self.errors[self.open]
        noise = robust_sigma(measured, NOISE_FLOOR) if len(measured) else NOISE_FLOOR
        self.sigma = math.hypot(noise, MODEL_ERROR * contrast_of(look))
        self.where = np.flatnonzero(chosen)
        self.radius_m = seen.radius_m[chosen]
        self.shape = patch.raster.shape


def _lit(patch: Patch, seen: Predicted, look: Look) -> Look:
    """The look with the levels of black, white and wall that fit the picture best."""
    levels = [appearance.BLACK, appearance.WHITE, appearance.WALL]
    design = seen.derivative[patch.chosen][:, levels]
    light = _light(patch.gray[patch.chosen], look.tone)
    found = np.linalg.lstsq(design, light, rcond=1e-6)[0].tolist()
    step = np.zeros(appearance.PARAMETERS)
    step[levels] = np.array(found) - (look.black, look.white, look.wall[0])
    return look.moved(step)


def _prior(look: Look) -> Array:
    """Inverse variances (25,) of the nuisances about zero; none of what has no prior."""
    prior = np.zeros(appearance.PARAMETERS)
    prior[appearance.SIZE] = SIZE_SIGMA**-2
    prior[appearance.MARGIN] = MARGIN_SIGMA_M**-2
    stretch = (STRETCH_SIGMA * look.blur_px2) ** -2
    prior[appearance.STRETCH_X] = prior[appearance.STRETCH_XY] = stretch
    contrast = max(abs(look.white - look.black), 0.01)
    prior[appearance.VEIL] = (VEIL_SIGMA * contrast) ** -2
    prior[appearance.PEDESTAL] = PEDESTAL_SIGMA**-2
    wall = WALL_SIGMA * max(contrast, look.wall[0])
    prior[appearance.WALL_X] = prior[appearance.WALL_Y] = wall**-2
    prior[appearance.SHADE_X] = prior[appearance.SHADE_Y] = SHADE_SIGMA**-2
    prior[appearance.TONE] = TONE_SIGMA**-2
    return prior


def _nuisances(look: Look) -> Array:
    """Values (25,) of what has a prior."""
    at = np.zeros(appearance.PARAMETERS)
    at[appearance.SIZE] = look.size
    at[appearance.MARGIN] = look.margin_m
    at[appearance.STRETCH_X], at[appearance.STRETCH_XY] = look.stretch_px2
    at[appearance.WALL_X], at[appearance.WALL_Y] = look.wall[1:]
    at[appearance.SHADE_X], at[appearance.SHADE_Y] = look.shade
    at[appearance.VEIL] = look.veil
    at[appearance.TONE], at[appearance.PEDESTAL] = look.tone - SRGB_TONE, look.pedestal
    return at


def _cost(
    state: _State, look: Look, prior: Array, plane: InverseDepthPlane | None, sigma: float
) -> float:
    cost = _robust_cost(state.errors, sigma) + float(prior @ np.square(_nuisances(look)))
    if plane is not None:
        error = look.normal / float(look.normal @ look.center) - plane.coefficients
        cost += float(error @ plane.information @ error)
    return cost


def _robust_cost(errors: Array, sigma: float) -> float:
    """Sum of Tukey's losses, near zero the squared errors in standard deviations."""
    inside = np.maximum(1 - np.square(errors / (TUKEY * sigma)), 0.0)
    return TUKEY**2 / 3 * float((1 - inside * inside * inside).sum())


def _normal_equations(
    state: _State, look: Look, prior: Array, plane: InverseDepthPlane | None
) -> tuple[Array, Array]:
    weights = tukey_weights(state.errors, state.sigma) / state.sigma**2
    weighted = state.derivative.T * weights
    h = weighted @ state.derivative
    g = weighted @ state.errors
    h.flat[:: len(h) + 1] += prior
    g += prior * _nuisances(look)
    if plane is not None:
        h_plane, g_plane = plane_terms(plane, look.center, look.normal)
        h[:6, :6] += h_plane
        g[:6] += g_plane
    return h, g


def _conclude(
    state: _State, look: Look, prior: Array, plane: InverseDepthPlane | None, board: Board
) -> AppearanceFit | None:
    biweights = tukey_weights(state.errors, state.sigma)
    inliers = biweights > 0
    if np.count_nonzero(inliers) < MIN_PIXELS:
        return None
    sigma = state.sigma * math.sqrt(_alike(state, biweights))
    weighted = state.derivative.T * (biweights / sigma**2)
    h = weighted @ state.derivative
    h.flat[:: len(h) + 1] += prior
    h = _without_roll(h, look)
    scale = np.sqrt(np.maximum(np.diagonal(h), 1e-12))
    h = h / np.outer(scale, scale) + 1e-9 * np.eye(len(h))
    information = h[:6, :6] - h[:6, 6:] @ np.linalg.solve(h[6:, 6:], h[6:, :6])
    information = information * np.outer(scale[:6], scale[:6])
    information = _without_roll(information, look)
    if plane is not None:
        information = information + plane_terms(plane, look.center, look.normal)[0]
    prior_cost = float(prior @ np.square(_nuisances(look)))
    information = 0.5 * (information + information.T)
    inner = board.circles[min(1, len(board.circles) - 1)]
    inside = state.radius_m < INSIDE * inner.radius_m
    return AppearanceFit(
        look,
        information,
        state.errors,
        state.sigma,
        sigma,
        inliers,
        prior_cost,
        _explained(state, inliers),
        _explained(state, inside),
    )


def _explained(state: _State, used: NDArray[np.bool_]) -> float:
    if not used.any():
        return 0.0
    spread = float(np.var(state.gray[used]))
    return 1 - float(np.square(state.errors[used]).mean()) / max(spread, 1e-9)


def _without_roll(h: Array, look: Look) -> Array:
    """Information with the turn about the normal marginalised."""
    axis = np.zeros(len(h))
    axis[appearance.TURN] = look.normal
    along = h @ axis
    of_roll = float(axis @ along)
    return h if of_roll <= 1e-9 else np.asarray(h - np.outer(along, along) / of_roll)


def _alike(state: _State, weights: Array) -> float:
    """The number of neighbouring pixels that err as one, from the errors' sums over cells."""
    rows, columns = np.divmod(state.where, state.shape[1])
    across = state.shape[1] // CELL_PX + 1
    errors = weights * state.errors
    sums = np.bincount(rows // CELL_PX * across + columns // CELL_PX, errors)
    alike = float(sums @ sums) / max(float(errors @ errors), 1e-300)
    return max(CELL_BORDER_LOSS * alike, 1.0)


def coded(light: Array, tone: float) -> tuple[Array, Array, Array]:
    """Grey values (N,) of light (N,), and their derivatives by light and tone."""
    x = np.maximum(light, DARKEST)
    power = 255 * x**tone
    inside = light > DARKEST
    return power, np.where(inside, power * tone / x, 0.0), power * np.log(x)


def _light(gray: Array, tone: float) -> Array:
    """Light (N,) of grey values."""
    return np.asarray((gray / 255) ** (1 / tone))
