"""From many sightings to what is wrong with the rig: scale, place and turn of the depth camera.

A plane n.p = d in the colour frame is measured by a depth camera whose file is wrong by a factor
1 + k in depth, a shift t and a small turn w (both of ``color_from_depth``, colour frame) as

    n' = n + w x n            d' = (1 + k) d + n.t

so that each sighting gives three equations: the normals' difference across the line of n, and
the distance of the circles' centre c from the measured plane, d' - n'.c = k d + n.t - w.(n x c).
docs/localisation.md tells what of it which recording can show.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from drone_client.calibration.sighting import Sighting
from rgbd_wire.geometry import Array, Pose, rotation_from_vector, skew
from target_pose.tukey import robust_sigma, tukey_weights
from target_pose.vectors import length, orthogonal_to

PRIOR: Final = np.array([0.1, *[0.05] * 3, *[math.radians(5)] * 3])
"""Standard deviations that are believed before anything is seen; a quantity that keeps about this
one was not seen."""
FLOOR_M: Final = 5e-4
FLOOR_SHARE: Final = 1e-3
"""Least error of a distance: printing, paper, the lens model."""
FLOOR_RAD: Final = math.radians(0.5)
"""Least error of a normal between the two: warp of the depth picture."""
SURE_TILT_RAD: Final = math.radians(10.0)
"""Under it the circles' normal is not taken: which way a frontal circle leans is not sure."""
CORRELATED_POINTS: Final = 16.0
"""Depth pixels that err as one."""
PASSES = 6


@dataclass(frozen=True, slots=True, eq=False)
class RigErrors:
    """What the camera file says less what is true."""

    estimate: Array  # (7,)
    """k, t [m], w [rad] (the colour frame's axes)."""
    covariance: Array  # (7, 7)
    gap_share: Array  # (N,)
    """Of each sighting: plane over circles less one, along the line of sight."""
    residual_m: Array  # (N,)
    """Distances of the centres from the planes that the estimate does not explain."""

    @property
    def sigma(self) -> Array:
        """Standard deviations, (7,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def corrected(color_from_depth: Pose, errors: Array) -> Pose:
    """``color_from_depth`` without the shift and the turn of errors (7,)."""
    turn = rotation_from_vector(-errors[4:])
    return Pose.from_rotation(
        turn @ color_from_depth.rotation, color_from_depth.translation - errors[1:4]
    )


def fit_rig(sightings: Sequence[Sighting], color_from_depth: Pose) -> RigErrors:
    """Weighted least squares with Tukey's biweight over sightings that have a plane.

    The standard deviations come from the scatter of the residuals and not from the sensors' data
    sheets, with neighbouring frames taken to err together as they are seen to.
    """
    rows = [_equations(s, color_from_depth) for s in sightings]
    design = np.concatenate([r.design for r in rows])
    values = np.concatenate([r.values for r in rows])
    prior = np.diag(PRIOR**-2)
    biweight = np.ones(len(values))
    estimate = np.zeros(7)
    for _ in range(PASSES):
        weighted = design.T * biweight
        estimate = np.linalg.solve(weighted @ design + prior, weighted @ values)
        errors = values - design @ estimate
        # in standard deviations, of which one is believed at least
        biweight = tukey_weights(errors, robust_sigma(errors, 1.0))
    first = np.zeros(len(values), dtype=bool)
    first[np.cumsum([0, *(len(r.values) for r in rows[:-1])])] = True
    information = prior
    for group in (first, ~first):  # distances and normals each by their own scatter
        if group.any():
            mine = design[group]
            inflation = _inflation(errors[group], biweight[group], 1 if group is first else 2)
            information = information + (mine.T * biweight[group]) @ mine / inflation
    sigma_m = np.array([r.sigma_m for r in rows])
    gaps = np.array([r.gap_share for r in rows])
    return RigErrors(
        estimate, np.asarray(np.linalg.inv(information)), gaps, errors[first] * sigma_m
    )


class _Equations(NamedTuple):
    design: Array  # (1 or 3, 7), over its standard deviation
    values: Array  # (1 or 3,)
    sigma_m: float
    """Of the first one, the distance."""
    gap_share: float
    """Plane over circles less one, along the line of sight."""


def _equations(s: Sighting, color_from_depth: Pose) -> _Equations:
    assert s.plane is not None
    normal = color_from_depth.rotation @ s.plane.normal
    center = s.circles.center
    center_depth = color_from_depth.inverse() @ center
    coefficients = s.plane.coefficients
    # n.p = d with n towards the camera: coefficients are n / d, and d < 0
    distance = -1 / length(coefficients)
    gap = distance - float(s.plane.normal @ center_depth)
    z = float(center_depth[2])
    depth_sigma = z * z * s.plane.sigma * math.sqrt(CORRELATED_POINTS / s.plane.inliers)
    range_m = s.circles.range_m
    sigma_m = math.hypot(FLOOR_M, FLOOR_SHARE * range_m, depth_sigma)
    d = float(normal @ center)
    row = np.concatenate([[d], normal, -np.cross(normal, center)])
    designs, values = [row / sigma_m], [gap / sigma_m]
    if s.circles.tilt_rad > SURE_TILT_RAD:
        reach_m = 0.5 * range_m * math.tan(0.1)  # of a disc: what a tilt moves at its rim
        warp = math.hypot(FLOOR_RAD, s.circles.normal_sigma_rad, depth_sigma / reach_m)
        across = np.stack(orthogonal_to(s.circles.normal))
        turn = np.zeros((2, 7))
        turn[:, 4:] = across @ -skew(s.circles.normal)
        designs += list(turn / warp)
        values += list(across @ (normal - s.circles.normal) / warp)
    return _Equations(np.stack(designs), np.array(values), sigma_m, gap / d)


def _inflation(errors: Array, biweight: Array, stride: int) -> float:
    """By how much the variance of a mean of these errors exceeds that of independent unit ones.

    Chi square over its degrees of freedom, times (1 + r) / (1 - r) with r the correlation of
    neighbouring frames (``stride`` errors apart): a slow flight sees the same depth noise again.
    """
    freedom = max(float(biweight.sum()) - len(PRIOR), 1.0)
    chi2 = float(biweight @ np.square(errors)) / freedom
    series = errors - errors.mean()
    power = float(series @ series)
    r = 0.0
    if power > 0 and len(series) > 3 * stride:
        r = float(series[stride:] @ series[:-stride]) / power
    r = min(max(r, 0.0), 0.9)
    return max(chi2, 0.05) * (1 + r) / (1 - r)
