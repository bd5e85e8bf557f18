"""The printed rings of a target in a picture: do they have the right shades?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from target_pose.candidate import Box
from target_pose.target import Level, Shade, Target

RAYS = 32
MIN_RAYS_SEEN = 8
"""An edge that fewer rays see is not judged; at least one must be."""
MIN_RING_PX = 1.5
"""A ring thinner than this is not to be seen."""
THICK_RING_PX = 8.0
"""Where no box vouches for a ring's width, all samples of a ring this thick must agree."""
MIN_CONTRAST_LEVELS, MIN_CONTRAST = 4.0, 0.12
"""Least step between two shades: gray levels, and a share of the lighter one."""

SURE_SHARE = 0.95
"""Better need not be searched for."""

_SKEWS = (0.0, 0.4, -0.4, 0.7, -0.7, 0.88, -0.88)
"""Correlations of the ellipse in a box: a box alone does not say which way a tilted disc leans."""
_STRETCHES = ((0.85, 1.0), (1.0, 0.85), (0.85, 0.85))
"""True width and height of a disc per those of its box: nets draw a strongly tilted one wide."""
_RING_SAMPLES, _DOT_SAMPLES = (0.3, 0.5, 0.7), (0.0, 0.3, 0.6)
"""Where a ring and the innermost disc are sampled, as a share of the way outwards."""


def _unit_ellipses(stretches: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """Points (S, 2, RAYS) of the ellipses in stretched squares of half side one, in all skews."""
    angle = np.linspace(0, 2 * np.pi, RAYS, endpoint=False)
    x, y = np.cos(angle), np.sin(angle)
    return np.stack(
        [
            np.stack((w * x, h * (k * x + math.sqrt(1 - k * k) * y)))
            for w, h in stretches
            for k in _SKEWS
        ]
    )


_TIGHT = _unit_ellipses([(1.0, 1.0)])
_LOOSE = _unit_ellipses(_STRETCHES)


def is_board(level: Level, target: Target) -> bool:
    """Whether a level's box circumscribes the board, whose box grows when it rolls."""
    return math.isclose(target.level_m[level], target.board_side_m)


def shades_share(gray: NDArray[np.uint8], boxes: dict[Level, Box], target: Target) -> float:
    """On what share of the rays the rings inside and around the discs' boxes have their shades.

    Of the printed edges the one that fits worst counts; of the ellipses that a box may hold, the
    one that fits best.

    Args:
        gray: (H, W).
        boxes: With at least one disc's. Where a level lacks, the widths of the rings are checked
            in the picture; else the boxes have told them.
        target: Sizes and shades.

    Returns:
        In [0, 1]; 0 where no edge can be judged.
    """
    circles, thick_px = _circles(boxes, target), THICK_RING_PX
    if len(boxes) == len(target.level_m):
        thick_px = math.inf
    tight = float(_edges_share(gray, circles, target, _TIGHT, thick_px).max())
    if tight >= SURE_SHARE:
        return tight
    return max(tight, float(_edges_share(gray, circles, target, _LOOSE, thick_px).max()))


class _Circles(NamedTuple):
    """Where a circle around the target's centre is seen, linear in its radius.

    Two discs tell how perspective shifts and swells the circles; one alone stands for all.
    """

    center_px: NDArray[np.float64]  # (2, 2)
    """Slope [px/m] and value at zero of the centre, for u and v."""
    px_per_m: NDArray[np.float64]  # (2, 2)
    """Slope and value at zero of the half side per metre of radius, for u and v."""


def _circles(boxes: dict[Level, Box], target: Target) -> _Circles:
    discs = [(target.level_m[k] / 2, b) for k, b in boxes.items() if not is_board(k, target)]
    radius = np.array([r for r, _ in discs])
    center = np.array([b.center_px for _, b in discs])
    scale = np.array([b.size_px for _, b in discs]) / 2 / radius[:, None]
    if len(discs) == 1:
        still = np.zeros((1, 2))
        return _Circles(np.concatenate((still, center)), np.concatenate((still, scale)))
    return _Circles(np.polyfit(radius, center, 1), np.polyfit(radius, scale, 1))


def _edges_share(
    gray: NDArray[np.uint8],
    circles: _Circles,
    target: Target,
    unit: NDArray[np.float64],
    thick_px: float,
) -> NDArray[np.float64]:
    """Share of right rays of the worst printed edge that can be seen; one per shape.

    A circle is taken as one of the shapes ``unit`` in its box. Axes: S shapes, K rings from the
    outside in, 3 samples across a ring, R rays.
    """
    radii = [target.board_side_m / 2, *(d.diameter_m / 2 for d in target.discs), 0.0]
    black = np.array(
        [target.board_shade is Shade.BLACK, *(d.shade is Shade.BLACK for d in target.discs)]
    )
    outer, inner = np.array(radii[:-1]), np.array(radii[1:])
    share = np.where((inner > 0)[:, None], _RING_SAMPLES, _DOT_SAMPLES)
    radius = inner[:, None] + share * (outer - inner)[:, None]  # (K, 3)
    basis = np.stack((radius, np.ones_like(radius)), axis=-1)
    center, scale = basis @ circles.center_px, basis @ circles.px_per_m  # (K, 3, 2)
    reach = (radius[..., None] * scale)[None, ..., None] * unit[:, None, None]  # (S, K, 3, 2, R)
    u, v = np.moveaxis(center[None, ..., None] + reach, 3, 0).astype(np.float32)  # (S, K, 3, R)
    height, width = gray.shape
    inside = ((u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)).all(axis=2)
    flat = (-1, RAYS)
    sampled = cv2.remap(gray, u.reshape(flat), v.reshape(flat), cv2.INTER_LINEAR)
    value = np.asarray(sampled, np.float64).reshape(u.shape)
    across = (outer - inner)[None, :, None] * np.hypot(
        *np.moveaxis(scale[None, :, 1, :, None] * unit[:, None], 2, 0)
    )  # (S, K, R) width of a ring [px]
    # A thin ring's edges are blurred into it: its mean. Of a thick one the sample that speaks most
    # against its shade, so that a ring of another width does not pass.
    against = np.where(black[:, None], value.max(axis=2), value.min(axis=2))
    ring = np.where(across >= thick_px, against, value.mean(axis=2))
    step = (ring[:, :-1] - ring[:, 1:]) * np.where(black[:-1], -1.0, 1.0)[:, None]
    lighter = np.maximum(ring[:, :-1], ring[:, 1:])
    right = step > np.maximum(MIN_CONTRAST_LEVELS, MIN_CONTRAST * lighter)
    seen = inside[:, :-1] & inside[:, 1:]
    seen &= np.minimum(across[:, :-1], across[:, 1:]) >= MIN_RING_PX
    count = seen.sum(axis=2)  # (S, K - 1)
    judged = count >= MIN_RAYS_SEEN
    share = (right & seen).sum(axis=2) / np.maximum(count, 1)
    worst = np.where(judged, share, 1.0).min(axis=1)
    return np.asarray(np.where(judged.any(axis=1), worst, 0.0))
