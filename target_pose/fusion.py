"""Circle edges and the depth's plane fused to one pose by inverse variance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import rotation_from_vector, skew
from target_pose.circle_edges import CircleEdges
from target_pose.conic import CirclePose
from target_pose.plane import InverseDepthPlane
from target_pose.tukey import robust_sigma, tukey_weights
from target_pose.vectors import length

Array: TypeAlias = NDArray[np.float64]

DARK_SHIFT_SIGMA_PX = 0.3
"""How far tone curve, glare and ink may move every edge towards its dark side; the inner circles,
whose dark side is the other one, measure it where they are seen."""
SIZE_SIGMA = 1.5e-3
"""Relative error of print size over focal length, which no picture of one target shows."""
EDGE_FLOOR_PX = 0.04
"""Least standard deviation of one edge point: pixel raster, JPEG."""
TILT_DAMPING = 10.0
"""[1/rad^2] Keeps a step finite where a frontal circle says nothing of its tilt to first order."""
OUTLIER_COST = 25.0
"""Squared standard deviations past which an error says no more than that the point is wrong."""
ITERATIONS = 10
CONVERGED = 1e-4
"""Last step [rad], or over the range, after which the next one would be no more than rounding."""
NEAREST_M = 0.05
MIN_M_PER_PX = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class CircleFit:
    """The pose, up to its roll, that explains the edges (and the plane) best."""

    pose: CirclePose
    information: Array  # (6, 6)
    """Inverse covariance of (translation, rotation vector), camera frame; says nothing of roll."""
    errors_px: Array  # (N,)
    """Of all edge points, outliers too."""
    sigma: float
    """Robust standard deviation of the errors [px]."""
    inliers: NDArray[np.bool_]  # (N,)
    share: Array  # (N,)
    """What each point counts for."""
    prior_cost: float
    """Of the nuisances, in squared standard deviations."""
    edges: CircleEdges
    """What was fitted."""

    @property
    def rms_px(self) -> float:
        """Root mean square error of the inliers."""
        return float(np.sqrt(np.square(self.errors_px[self.inliers]).mean()))

    def cost(self, sigma: float) -> float:
        """Squared errors in standard deviations, an outlier's taken as 5 sigma."""
        squares = np.minimum(np.square(self.errors_px / sigma), OUTLIER_COST)
        return float(self.share @ squares) + self.prior_cost


class _System(NamedTuple):
    """Errors [px] of the edge points and their derivatives (N, 8) by pose, shift and size."""

    errors: Array
    jacobian: Array


def fit_circles(
    edges: CircleEdges,
    intrinsics: CameraIntrinsics,
    start: CirclePose,
    plane: InverseDepthPlane | None = None,
) -> CircleFit | None:
    """Gauss-Newton on the edges' distances from the projected circles and on the plane.

    Unknowns are the centre, the normal and two nuisances: ``DARK_SHIFT_SIGMA_PX`` and
    ``SIZE_SIGMA`` are their priors. The plane enters as a Gaussian on n / (n . c), its parameters
    in inverse depth. The result is the maximum-likelihood fusion; with the two sources' Gaussians
    it is the mean weighted by inverse variance.

    Returns:
        The fit, or None where it leaves the half-space in front of the camera.
    """
    center, normal = start
    shift = size = 0.0
    rays = np.column_stack([edges.xy, np.ones(len(edges.xy))])
    prior = np.zeros(8)
    prior[6], prior[7] = DARK_SHIFT_SIGMA_PX**-2, SIZE_SIGMA**-2
    system = _system(rays, edges, intrinsics, center, normal, shift, size)
    for _ in range(ITERATIONS):
        if system is None:
            return None
        sigma = robust_sigma(system.errors, EDGE_FLOOR_PX)
        weights = tukey_weights(system.errors, sigma) * edges.share / sigma**2
        weighted = system.jacobian.T * weights
        h = weighted @ system.jacobian
        g = weighted @ system.errors
        g[6] += prior[6] * shift
        g[7] += prior[7] * size
        h.flat[::9] += prior
        if plane is not None:
            h_plane, g_plane = plane_terms(plane, center, normal)
            h[:6, :6] += h_plane
            g[:6] += g_plane
        damped = h.copy()
        damped[3:6, 3:6] += TILT_DAMPING * np.eye(3)
        # nothing moves the roll: keep it where it is
        damped[3:6, 3:6] += 1e6 * np.outer(normal, normal)
        damped[:3, :3] += 1e-6 * np.eye(3)
        step = -np.linalg.solve(damped, g)
        turn = length(np.asarray(step[3:6]))
        if turn > 0.3:
            step *= 0.3 / turn
        center = center + step[:3]
        normal = rotation_from_vector(np.asarray(step[3:6])) @ normal
        shift, size = shift + float(step[6]), size + float(step[7])
        system = _system(rays, edges, intrinsics, center, normal, shift, size)
        if np.abs(step[:3]).max() < CONVERGED * center[2] and turn < CONVERGED:
            break
    if system is None:
        return None
    return _conclude(edges, system, CirclePose(center, normal), plane, (shift, size), prior)


def _conclude(
    edges: CircleEdges,
    system: _System,
    pose: CirclePose,
    plane: InverseDepthPlane | None,
    nuisances: tuple[float, float],
    prior: Array,
) -> CircleFit | None:
    sigma = robust_sigma(system.errors, EDGE_FLOOR_PX)
    biweights = tukey_weights(system.errors, sigma)
    inliers = biweights > 0
    if not inliers.any():
        return None
    h = (system.jacobian.T * (biweights * edges.share / sigma**2)) @ system.jacobian
    h.flat[::9] += prior
    # the nuisances are marginalised: Schur complement
    information = h[:6, :6] - h[:6, 6:] @ np.linalg.solve(h[6:, 6:], h[6:, :6])
    if plane is not None:
        information = information + plane_terms(plane, *pose)[0]
    prior_cost = float(prior[6:] @ np.square(nuisances))
    information = 0.5 * (information + information.T)
    return CircleFit(
        pose, information, system.errors, sigma, inliers, edges.share, prior_cost, edges
    )


def _system(
    rays: Array,
    edges: CircleEdges,
    intrinsics: CameraIntrinsics,
    center: Array,
    normal: Array,
    shift_px: float,
    size: float,
) -> _System | None:
    """Each point's ray d (N, 3) is cut with the board's plane: its distance from its circle, in px.

    With q = d (n.c)/(n.d) - c and e = |q| - r (1 + size), divided by e's gradient in the picture:
    the first-order distance of the point from the projected circle (P. D. Sampson, 1982).
    """
    facing = float(normal @ center)
    along = rays @ normal
    if not (center[2] > NEAREST_M and facing < -1e-3 and along.max() < -1e-6):
        return None
    stretch = facing / along
    q = rays * stretch[:, None] - center
    distance = np.maximum(np.sqrt(np.einsum("ij,ij->i", q, q)), 1e-9)
    outwards = q / distance[:, None]
    slant = np.einsum("ij,ij->i", outwards, rays) / along
    by_ray = outwards[:, :2] - slant[:, None] * normal[:2]
    by_pixel = by_ray / (intrinsics.fx, intrinsics.fy)
    px_per_m = 1 / np.maximum(
        stretch * np.sqrt(np.einsum("ij,ij->i", by_pixel, by_pixel)), MIN_M_PER_PX
    )
    jacobian = np.empty((len(rays), 8))
    lean = (slant * px_per_m)[:, None]
    jacobian[:, :3] = lean * normal - outwards * px_per_m[:, None]
    jacobian[:, 3:6] = -lean * (q @ skew(normal).T)
    jacobian[:, 6] = edges.dark_side
    jacobian[:, 7] = -edges.radius_m * px_per_m
    errors = (distance - edges.radius_m * (1 + size)) * px_per_m + edges.dark_side * shift_px
    return _System(errors, jacobian)


def plane_terms(plane: InverseDepthPlane, center: Array, normal: Array) -> tuple[Array, Array]:
    """Normal equations (6, 6), (6,) of the plane's measurement of n / (n . c)."""
    error, jacobian = plane_error(plane, center, normal)
    weighted = jacobian.T @ plane.information
    return weighted @ jacobian, weighted @ error


def plane_error(plane: InverseDepthPlane, center: Array, normal: Array) -> tuple[Array, Array]:
    """Of n / (n . c) less the plane's coefficients (3,), and its derivative (3, 6) by the pose."""
    facing = float(normal @ center)
    by_normal = np.eye(3) / facing - np.outer(normal, center) / facing**2
    jacobian = np.empty((3, 6))
    jacobian[:, :3] = -np.outer(normal, normal) / facing**2
    jacobian[:, 3:] = -by_normal @ skew(normal)
    return normal / facing - plane.coefficients, jacobian
