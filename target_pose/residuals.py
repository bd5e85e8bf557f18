"""How well the evidence fits and how sure a pose is, in the directions that people ask about."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from target_pose.covariance import covariance_from_information
from target_pose.fusion import CircleFit
from target_pose.localisation import CirclesFit, Evidence, Localisation
from target_pose.plane import InverseDepthPlane
from target_pose.vectors import angle, length, orthogonal_to, unit

Array: TypeAlias = NDArray[np.float64]

LOOSE_ROLL_RAD = 0.5
"""Stands in for the roll where only the centre is asked for: circles do not show it."""


class Spread(NamedTuple):
    """Standard deviations of a pose, apart by direction."""

    range_m: float
    """Along the line of sight."""
    across_m: float
    """Across it, in the worse direction."""
    normal_rad: float
    """Of the board's normal, in the worse direction."""
    roll_rad: float
    """About the normal."""


class CircleResidual(NamedTuple):
    """Edge points of one printed circle."""

    diameter_m: float
    measured: int
    used: int
    rms_px: float | None
    """Root mean square of the used ones; None: there is none."""


@dataclass(frozen=True, slots=True)
class Residuals:
    """How circles and plane fit, and how they agree."""

    circles: tuple[CircleResidual, ...]
    """From the outermost one measured inwards; none where pixels were fitted and not edges."""
    range_ellipse_sigma_m: float
    """Standard deviation of ``range_ellipse_m``."""
    range_plane_sigma_m: float | None
    """Of ``range_plane_m``, the depth's errors of scale and warp included."""
    ranges_apart_sigmas: float | None
    """Plane range less ellipse range over the standard deviation of the difference."""


def tilt_rad(located: Localisation) -> float:
    """Angle between the board's normal and the line of sight."""
    pose = located.camera_from_target
    return angle(pose.rotation[:, 0], -unit(pose.translation))


def spread(located: Localisation) -> Spread:
    """The covariance in the directions that people ask about."""
    pose = located.camera_from_target
    position, rotation = located.covariance[:3, :3], located.covariance[3:, 3:]
    line, normal = unit(pose.translation), unit(pose.rotation[:, 0])
    return Spread(
        range_m=_deviation(position, line),
        across_m=_widest_across(position, line),
        # a turn about an axis across the normal tilts it by as much
        normal_rad=_widest_across(rotation, normal),
        roll_rad=_deviation(rotation, normal),
    )


def residuals(located: Localisation) -> Residuals | None:
    """How the evidence fits; None where the pose does not rest on circles."""
    seen = located.evidence
    if seen is None:
        return None
    ellipse_sigma = circle_range_sigma_m(seen.circles_alone)
    plane_sigma = apart = None
    if seen.plane is not None and located.range_plane_m is not None:
        plane_sigma = plane_range_sigma_m(seen.plane, seen.circles_alone.pose.center)
        if located.range_ellipse_m is not None:
            difference = located.range_plane_m - located.range_ellipse_m
            apart = difference / math.hypot(ellipse_sigma, plane_sigma)
    return Residuals(_by_circle(seen), ellipse_sigma, plane_sigma, apart)


def circle_range_sigma_m(fit: CirclesFit) -> float:
    """Standard deviation of the distance to the circles' centre."""
    center, normal = fit.pose
    covariance = covariance_from_information(fit.information, normal, center, LOOSE_ROLL_RAD)
    return _deviation(covariance[:3, :3], unit(center))


def plane_range_sigma_m(plane: InverseDepthPlane, center: Array) -> float:
    """Standard deviation of the distance to a plane along the bearing of a point (3,)."""
    ray = center / center[2]
    z = plane.depth_along(ray)
    covariance = np.asarray(np.linalg.inv(plane.information), dtype=np.float64)
    return z * z * _deviation(covariance, ray) * length(ray)


def _by_circle(seen: Evidence) -> tuple[CircleResidual, ...]:
    fit = seen.circles
    if not isinstance(fit, CircleFit):
        return ()
    radii = fit.edges.radius_m
    found = []
    for radius in np.unique(radii)[::-1]:
        mine = radii == radius
        used = fit.errors_px[mine & fit.inliers]
        rms = float(np.sqrt(np.square(used).mean())) if len(used) else None
        found.append(CircleResidual(2 * float(radius), int(mine.sum()), len(used), rms))
    return tuple(found)


def _deviation(covariance: Array, direction: Array) -> float:
    return math.sqrt(max(float(direction @ covariance @ direction), 0.0))


def _widest_across(covariance: Array, axis: Array) -> float:
    basis = np.stack(orthogonal_to(axis))
    return math.sqrt(max(float(np.linalg.eigvalsh(basis @ covariance @ basis.T)[-1]), 0.0))
