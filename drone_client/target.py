"""The target in the world: accepted measurements, composed at capture time, gated and fused.

State: ``world_from_target`` with the covariance of a perturbation from the left in world axes,
translation first, then rotation vector. The target stands still; what drifts is the drone's own
odometry, and that is the process noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np

from drone_client.bounds import check_bounds
from rgbd_wire.geometry import (
    Array,
    Pose,
    quaternion_from_rotation,
    quaternion_product,
    rotation_from_vector,
    skew,
    vector_from_rotation,
)

GATE_CHI2 = 27.86
"""Squared Mahalanobis distance, six degrees of freedom, 99.99 %."""
OUTLIERS_BEFORE_RESET = 4
"""So many measurements in a row that disagree with the estimate mean that it is the estimate that
is wrong: it starts again from the newest."""
MAX_VARIANCE = 1e3
"""Sum of a measurement's six variances [m^2, rad^2] above which it says nothing; below it,
odometry's own share keeps every matrix here positive definite, whatever the rounding does."""

_BUDGET_BOUNDS: dict[str, tuple[float, float]] = {
    "sigma_m": (1e-4, 0.1),
    "sigma_rad": (1e-4, 0.1),
    "drift_mps": (0.0, 0.5),
    "drift_radps": (0.0, 0.5),
}


@dataclass(frozen=True, slots=True)
class OdometryBudget:
    """How wrong the drone's own odometry may be.

    Raises:
        ValueError: a value is out of its bounds, or no number.
    """

    sigma_m: float = 0.001
    sigma_rad: float = 0.005
    """Standard deviation of the camera's own pose at an exposure: odometry and mounting. Its
    attitude moves the target by range times angle, so it matters from afar and fades on the way
    in."""
    drift_mps: float = 0.01
    drift_radps: float = 0.005
    """How fast the odometry's world moves under the target."""

    def __post_init__(self) -> None:
        check_bounds(self, _BUDGET_BOUNDS)


USUAL_BUDGET = OdometryBudget()


class Source(StrEnum):
    """Whose eyes an estimate rests on."""

    EDGE = "edge"
    """A worker's results, through the delay gate."""
    ONBOARD = "onboard"
    """The drone's own look where the edge saw the target last; nobody has confirmed it."""


class Update(StrEnum):
    """What a measurement did to the estimate."""

    FIRST = "first"
    FUSED = "fused"
    OUTLIER = "outlier"
    RESET = "reset"
    AMBIGUOUS = "ambiguous"
    """Two folds fit: not used."""
    TOO_UNSURE = "too_unsure"
    """The worker itself says that it knows nothing: not used."""
    NO_POSE = "no_pose"
    """The drone does not know where it was at the exposure: not used."""
    BEFORE_JUMP = "before_jump"
    """The exposure was before the odometry jumped, in a world that is no more: not used."""


@dataclass(frozen=True, eq=False)
class TargetEstimate:
    """Where the target is believed to be; asked at every tick, and new with every result alone."""

    world_from_target: Pose
    covariance: Array  # (6, 6)
    """World axes [m^2, m rad, rad^2]."""
    t_capture_ns: int
    """Exposure of the newest measurement in it, drone's clock: the age of what is known."""
    range_m: float
    """From the camera to the target in that measurement."""
    outliers: int = 0
    """Measurements in a row that were not fused."""
    source: Source = Source.EDGE
    t_confirmed_ns: int | None = None
    """Exposure of the edge's newest measurement, on which an onboard one rests; None: the edge's
    own."""
    epoch: int = 0
    """In which of the odometry's worlds; a jump begins another (docs/odometry.md)."""
    budget: OdometryBudget = USUAL_BUDGET
    """What its covariance counts for the odometry."""

    @cached_property
    def sigma_m(self) -> float:
        """Standard deviation of the position along its worst axis [m]."""
        return float(np.sqrt(max(0.0, np.linalg.eigvalsh(self.covariance[:3, :3])[-1])))

    @cached_property
    def seen_sigma_m(self) -> float:
        """The same without the doubt that grows while nobody confirms: what was measured.

        The safety filter counts that doubt itself, at its age on every tick.
        """
        doubt_m = self.budget.drift_mps * self.unconfirmed_ns(self.t_capture_ns) * 1e-9
        return float(np.sqrt(max(0.0, self.sigma_m**2 - doubt_m**2)))

    def unconfirmed_ns(self, now_ns: int) -> int:
        """How long ago the edge saw the target last; 0 where it is the edge's own word."""
        return 0 if self.t_confirmed_ns is None else max(0, now_ns - self.t_confirmed_ns)


@dataclass(frozen=True, slots=True, eq=False)
class TargetMeasurement:
    """One accepted result in the world."""

    world_from_target: Pose
    covariance: Array  # (6, 6), world axes
    t_capture_ns: int
    range_m: float
    """From the camera to the target."""
    epoch: int = 0
    """In which of the odometry's worlds."""


def drift_covariance(dt_ns: int, budget: OdometryBudget = USUAL_BUDGET) -> Array:
    """By how much the target may have moved in the odometry's world in a time (6, 6)."""
    drift = np.repeat([budget.drift_mps, budget.drift_radps], 3) * max(0, dt_ns) * 1e-9
    return np.diag(drift**2)


def measure(
    world_from_camera: Pose,
    camera_from_target: Pose,
    covariance_camera: Array,
    t_capture_ns: int,
    *,
    epoch: int = 0,
    budget: OdometryBudget = USUAL_BUDGET,
) -> TargetMeasurement:
    """Compose a result with the camera's pose *at its exposure*.

    A left perturbation in camera axes is one in world axes after rotation by the camera's
    attitude: ``R_wc exp(d) R_ct = exp(R_wc d) R_wc R_ct``. An error ``f`` of that attitude turns
    the target by ``f`` and moves it by ``f x r``, with ``r`` from the camera to the target.

    Args:
        world_from_camera: of the colour camera, at the exposure.
        camera_from_target: as it was seen.
        covariance_camera: (6, 6) of that, in the camera's axes.
        t_capture_ns: exposure, drone's clock.
        epoch: of the odometry's worlds, the one that ``world_from_camera`` is told in.
        budget: how wrong it may be.
    """
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = world_from_camera.rotation
    line_world = world_from_camera.rotation @ camera_from_target.translation
    by_attitude = np.vstack([-skew(line_world), np.eye(3)])  # (6, 3)
    covariance = turn @ _without_negatives(covariance_camera) @ turn.T
    covariance += budget.sigma_rad**2 * by_attitude @ by_attitude.T
    covariance[:3, :3] += budget.sigma_m**2 * np.eye(3)
    range_m = float(np.linalg.norm(camera_from_target.translation))
    return TargetMeasurement(
        world_from_camera @ camera_from_target, covariance, t_capture_ns, range_m, epoch
    )


def _without_negatives(covariance: Array) -> Array:
    """The nearest positive semi-definite matrix: the wire lets rounding's negatives through."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def update(
    estimate: TargetEstimate | None,
    measurement: TargetMeasurement,
    budget: OdometryBudget = USUAL_BUDGET,
) -> tuple[TargetEstimate, Update]:
    """Fuse a measurement into the estimate: a Kalman step on the pose, behind a gate.

    The measurement's variances must sum to at most ``MAX_VARIANCE``. One of an older world changes
    nothing, and one of a newer world takes the estimate's place: the two have nothing in common.
    """
    m = measurement
    fresh = TargetEstimate(
        m.world_from_target,
        m.covariance,
        m.t_capture_ns,
        m.range_m,
        epoch=m.epoch,
        budget=budget,
    )
    if estimate is None or m.epoch > estimate.epoch:
        return fresh, Update.FIRST
    if m.epoch < estimate.epoch:
        return estimate, Update.BEFORE_JUMP

    prior = estimate.covariance + drift_covariance(m.t_capture_ns - estimate.t_capture_ns, budget)
    at, seen = estimate.world_from_target, m.world_from_target
    innovation = np.concatenate(
        [seen.translation - at.translation, vector_from_rotation(seen.rotation @ at.rotation.T)]
    )
    spread = prior + m.covariance
    distance2 = float(innovation @ np.linalg.solve(spread, innovation))
    if not distance2 <= GATE_CHI2:
        if estimate.outliers + 1 >= OUTLIERS_BEFORE_RESET:
            return fresh, Update.RESET
        return replace(estimate, outliers=estimate.outliers + 1), Update.OUTLIER

    gain = np.linalg.solve(spread, prior).T  # (6, 6), prior @ inv(spread)
    step = gain @ innovation
    turn = quaternion_from_rotation(rotation_from_vector(step[3:]))
    pose = Pose(at.translation + step[:3], quaternion_product(turn, at.q_wxyz))
    keep = np.eye(6) - gain
    # Joseph's form keeps the covariance symmetric and positive whatever the rounding does.
    posterior = keep @ prior @ keep.T + gain @ m.covariance @ gain.T
    fused = replace(fresh, world_from_target=pose, covariance=posterior)
    return fused, Update.FUSED
