"""The pose under which measured picture coordinates, and the depth's plane, fit a board best.

A measurement is one number: a pixel's coordinate along one direction. A labelled point is two of
them, the side of a box is one. All are of the ideal camera, the lens is undone before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.geometry import Pose, rotation_from_vector
from target_pose.fusion import NEAREST_M, OUTLIER_COST, SIZE_SIGMA, plane_error
from target_pose.plane import InverseDepthPlane
from target_pose.tukey import tukey_weights

Array: TypeAlias = NDArray[np.float64]

ITERATIONS = 60
"""It takes five, but for a board seen squarely: between its folds is a saddle, left slowly."""
CONVERGED, CONVERGED_SHARE = 1e-14, 1e-9
"""What the next step would gain, in squared standard deviations and over all that is left of them,
under which it is not taken."""
FIRST_DAMPING, MAX_DAMPING = 1e-4, 1e8
MAX_TURN_RAD = 0.5


class Predicted(NamedTuple):
    """What a pose says of the measurements."""

    values: Array  # (M,) [px]
    jacobian: Array  # (M, 7)
    """By translation, rotation vector (both camera frame) and the board's relative size."""


Predict: TypeAlias = Callable[[Array, Array, float], Predicted | None]
"""From translation (3,), rotation (3, 3) and relative size; None where a point is not ahead."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Picture coordinates and how sure they are."""

    values: Array  # (M,) [px]
    information: Array  # (M, M)
    """Their inverse covariance."""
    predict: Predict
    pairs: bool = True
    """Each two in a row are one point, of which both or none are wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class PnpFit:
    """A pose and how well it fits."""

    translation: Array  # (3,) [m]
    rotation: Array  # (3, 3)
    information: Array  # (6, 6)
    """Inverse covariance of (translation, rotation vector), the size marginalised, without any
    plane."""
    errors: Array  # (M,) [px]
    weights: Array  # (M,)
    """In [0, 1]; 0: left out as wrong."""
    cost: float
    """Squared standard deviations of picture and size, without the plane's; of one coordinate
    ``OUTLIER_COST`` at most where points were left out."""

    @property
    def normal(self) -> Array:
        """The board's unit normal (3,), towards the camera."""
        return np.asarray(self.rotation[:, 0])

    @property
    def pose(self) -> Pose:
        """``camera_from_target``."""
        return Pose.from_rotation(self.rotation, self.translation)


def predict_points(yz_m: Array, focal: Array) -> Predict:
    """Ideal pixels (2N,) of a board's points (N, 2), against a camera's fx and fy (2,)."""
    flat = np.column_stack([np.zeros(len(yz_m)), yz_m])

    def predict(translation: Array, rotation: Array, size: float) -> Predicted | None:
        return project_points(flat @ rotation.T, translation, focal, size)

    return predict


def project_points(
    true_arms: Array, translation: Array, focal: Array, size: float
) -> Predicted | None:
    """Ideal pixels of points (N, 3) that reach out from the board's centre, camera frame."""
    arms = true_arms * (1 + size)
    seen = arms + translation
    z = seen[:, 2]
    if not z.min() > NEAREST_M:  # true for NaN, too
        return None
    xy = seen[:, :2] / z[:, None]
    by_point = np.zeros((len(arms), 2, 3))
    by_point[:, 0, 0] = focal[0] / z
    by_point[:, 1, 1] = focal[1] / z
    by_point[:, :, 2] = -focal * xy / z[:, None]
    jacobian = np.empty((len(arms), 2, 7))
    jacobian[:, :, :3] = by_point
    # a turn r moves an arm a by r x a, and b . (r x a) = (a x b) . r
    ax, ay, az = arms.T[:, :, None]
    bx, by, bz = np.moveaxis(by_point, 2, 0)
    jacobian[:, :, 3] = ay * bz - az * by
    jacobian[:, :, 4] = az * bx - ax * bz
    jacobian[:, :, 5] = ax * by - ay * bx
    jacobian[:, :, 6] = np.einsum("nij,nj->ni", by_point, true_arms)
    return Predicted((xy * focal).ravel(), jacobian.reshape(-1, 7))


def fit_pose(
    measured: Measurements,
    start: Pose,
    plane: InverseDepthPlane | None = None,
    *,
    robust: bool = False,
    prior: Array | None = None,
) -> PnpFit | None:
    """Levenberg-Marquardt on the measurements, and on the plane's ``n / (n . c)``.

    The board's relative size is an unknown of its own, known to ``SIZE_SIGMA``: it is what print
    and focal length leave open.

    Args:
        measured: what was seen.
        start: near enough.
        plane: enters by its own covariance.
        robust: leave out points that do not fit (J. W. Tukey's biweight), judged by the start
            first, which most of them must agree on.
        prior: (6, 6) information about the start itself, for what the measurements do not show.

    Returns:
        The fit, or None where it leaves the half-space in front of the camera.
    """
    state = _State(start.translation.copy(), start.rotation, 0.0)
    weights = np.ones(len(measured.values))
    steps = _Steps(measured, start, plane, np.zeros((6, 6)) if prior is None else prior)
    if robust and (errors := steps.errors(state)) is not None:
        weights = point_weights(measured, errors)
        if 2 * np.count_nonzero(weights) < len(weights):
            weights = np.ones(len(measured.values))
    for _ in range(4 if robust else 1):
        settled = steps.descend(state, weights)
        if settled is None:
            return None
        state = settled
        if robust:
            errors = steps.errors(state)
            if errors is None:
                return None
            following = point_weights(measured, errors)
            unchanged = np.abs(following - weights).max() < 0.01
            weights = following
            if unchanged:
                break
    return steps.conclude(state, weights)


def point_weights(measured: Measurements, errors: Array) -> Array:
    """Biweights (M,) of the measurements by their errors (M,) in standard deviations."""
    scaled = errors * np.sqrt(np.diag(measured.information))
    if measured.pairs:
        # a point's distance, on the scale of one coordinate
        away = np.sqrt(np.square(scaled.reshape(-1, 2)).sum(axis=1) / 2)
        return np.repeat(tukey_weights(away, 1.0), 2)
    return tukey_weights(scaled, 1.0)


class _State(NamedTuple):
    translation: Array
    rotation: Array
    size: float


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """The least-squares problem, and how it is walked down."""

    measured: Measurements
    start: Pose
    plane: InverseDepthPlane | None
    prior: Array

    def errors(self, state: _State) -> Array | None:
        seen = self.measured.predict(*state)
        return None if seen is None else seen.values - self.measured.values

    def descend(self, state: _State, weights: Array) -> _State | None:
        """Down to the nearest minimum; None if the start itself is not in front of the camera."""
        now = self._system(state, weights)
        if now is None:
            return None
        damping = FIRST_DAMPING
        for _ in range(ITERATIONS):
            h, g, cost = now
            damped = h + np.diag(damping * np.diag(h) + 1e-9)
            step = -np.linalg.solve(damped, g)
            if -float(g @ step) < CONVERGED + CONVERGED_SHARE * cost:
                break
            turn = math.sqrt(float(step[3:6] @ step[3:6]))
            if turn > MAX_TURN_RAD:
                step *= MAX_TURN_RAD / turn
            moved = _State(
                state.translation + step[:3],
                rotation_from_vector(np.asarray(step[3:6])) @ state.rotation,
                state.size + float(step[6]),
            )
            following = self._system(moved, weights)
            if following is None or not following[2] <= cost:
                damping *= 10
                if damping > MAX_DAMPING:
                    break
                continue
            state, now, damping = moved, following, damping / 10
        return state

    def _system(self, state: _State, weights: Array) -> tuple[Array, Array, float] | None:
        """Normal equations (7, 7), (7,) and the cost."""
        seen = self.measured.predict(*state)
        normal = state.rotation[:, 0]
        if seen is None or not state.translation[2] > NEAREST_M:
            return None
        root = np.sqrt(weights)
        errors = root * (seen.values - self.measured.values)
        jacobian = root[:, None] * seen.jacobian
        weighted = jacobian.T @ self.measured.information
        h, g = weighted @ jacobian, weighted @ errors
        cost = float(errors @ self.measured.information @ errors)
        h[6, 6] += SIZE_SIGMA**-2
        g[6] += SIZE_SIGMA**-2 * state.size
        cost += (state.size / SIZE_SIGMA) ** 2
        off = _offset(self.start, state)
        h[:6, :6] += self.prior
        g[:6] += self.prior @ off
        cost += float(off @ self.prior @ off)
        if self.plane is not None:
            if not float(normal @ state.translation) < -1e-3:
                return None
            away, by_pose = plane_error(self.plane, state.translation, normal)
            weighted = by_pose.T @ self.plane.information
            h[:6, :6] += weighted @ by_pose
            g[:6] += weighted @ away
            cost += float(away @ self.plane.information @ away)
        return h, g, cost

    def conclude(self, state: _State, weights: Array) -> PnpFit | None:
        alone = _Steps(self.measured, self.start, None, self.prior)
        system = alone._system(state, weights)
        errors = self.errors(state)
        if system is None or errors is None:
            return None
        h, _, cost = system
        information = h[:6, :6] - np.outer(h[:6, 6], h[6, :6]) / h[6, 6]
        if (weights < 1).any():
            # with weights of their own, two folds could not be compared
            squares = np.square(errors) * np.diag(self.measured.information)
            cost = float(np.minimum(squares, OUTLIER_COST).sum()) + (state.size / SIZE_SIGMA) ** 2
        return PnpFit(
            state.translation,
            state.rotation,
            0.5 * (information + information.T),
            errors,
            weights,
            cost,
        )


def _offset(start: Pose, state: _State) -> Array:
    """How far a state (6,) is from the start, to first order in the turn."""
    turn = state.rotation @ start.rotation.T
    twist = 0.5 * (turn - turn.T)
    shift = state.translation - start.translation
    return np.array([*shift, twist[2, 1], twist[0, 2], twist[1, 0]])
