"""From boxes to targets: the levels of one target nest, have known size ratios and known shades.

A net fires on things that look alike: other ring markers, white discs on black, wheels, washers.
Two checks throw them out. *Geometry*: the boxes are concentric and their sizes have the target's
ratios, as far as tilt (to 70 degrees), perspective, a few pixels of error and a cut by the border
allow. *Shades*: along rays from the centre, each printed ring is darker or lighter than its
neighbour as the target's file says, whatever the light.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from target_pose.candidate import Box, Candidate, Detections
from target_pose.target import Level, Shade, Target

MAX_BOXES = 20
"""Boxes of one level that are looked at, best first: bounds the time in any picture."""

SIZE_SLACK_PX, SIZE_SLACK = 2.0, 0.10
"""Error of a box's side: pixels, and a share of the outer side."""
CENTER_SLACK_PX, CENTER_SLACK = 2.0, 0.06
"""Likewise of its centre."""
PERSPECTIVE_CENTER, PERSPECTIVE_SIZE = 0.30, 0.45
"""How far boxes of concentric shapes shift and swell in perspective, for a target as large as the
picture; in proportion for smaller ones (20 000 projected poses stay inside)."""
CUT_SLACK = 2.5
"""All slack grows by this along an axis on which the border cuts a box: the net has to guess."""

SINGLE_LEVEL_SCORE = 0.6
"""A level that stands alone must be this sure."""

RAYS = 32
MIN_RAYS_SHARE = 0.7
"""Share of the rays that see an edge on which it must have the right sign."""
MIN_RAYS_SEEN = 8
"""An edge that fewer rays see is not judged; at least one must be."""
MIN_RING_PX = 1.5
"""A ring thinner than this is not to be seen."""
THICK_RING_PX = 8.0
"""Of a ring this thick all samples must agree."""
MIN_CONTRAST_LEVELS, MIN_CONTRAST = 4.0, 0.12
"""Least step between two shades: gray levels, and a share of the lighter one."""

_SKEWS = (0.0, 0.4, -0.4, 0.7, -0.7, 0.88, -0.88)
"""Correlations of the ellipse in a box: a box alone does not say which way a tilted disc leans."""


def group(
    detections: Detections, target: Target, color_rgb: NDArray[np.uint8]
) -> tuple[Candidate, ...]:
    """The targets among a picture's boxes, best first; each box serves one target at most.

    A level may be missing (too small when far, out of the picture when near). A lone box is
    accepted for a disc's level if it is sure and the shades inside it are right.

    Args:
        detections: Boxes per level, best first.
        target: Sizes and shades.
        color_rgb: (H, W, 3), the picture of the boxes.
    """
    size = (color_rgb.shape[1], color_rgb.shape[0])
    boxes = {level: detections.boxes.get(level, ())[:MAX_BOXES] for level in Level}
    proposals = [
        Candidate(chosen, sum(b.score for b in chosen.values()) / len(Level))
        for chosen in _combinations(boxes, target, size)
    ]
    # More levels first: three boxes of a target outweigh any two of them
    proposals.sort(key=lambda c: c.score, reverse=True)
    gray = cv2.cvtColor(color_rgb, cv2.COLOR_RGB2GRAY) if proposals else None
    taken: set[int] = set()
    found = []
    for candidate in proposals:
        ids = {id(box) for box in candidate.boxes.values()}
        if ids & taken:
            continue
        assert gray is not None
        if shades_fit(np.asarray(gray, np.uint8), candidate.boxes, target):
            taken |= ids
            found.append(candidate)
    return tuple(found)


def nests(outer: Box, inner: Box, ratio: tuple[float, float], image_size: tuple[int, int]) -> bool:
    """Whether two boxes may circumscribe concentric shapes of one board.

    Args:
        outer: Box of the larger shape.
        inner: Box of the smaller one.
        ratio: Least and largest ratio of their sides without perspective.
        image_size: Width and height of the picture [px].
    """
    share = min(max(outer.size_px) / max(image_size), 1.0)
    ends = ((outer.x0, inner.x0, outer.x1, inner.x1), (outer.y0, inner.y0, outer.y1, inner.y1))
    for axis, (o0, i0, o1, i1) in enumerate(ends):
        cut = min(o0, i0) < 0 or max(o1, i1) > image_size[axis] - 1
        slack = CUT_SLACK if cut else 1.0
        side, inner_side = o1 - o0, i1 - i0
        size_slack = slack * (SIZE_SLACK_PX + SIZE_SLACK * side)
        most = ratio[1] * (1 + PERSPECTIVE_SIZE * share) * inner_side
        if not ratio[0] * inner_side - size_slack <= side <= most + size_slack:
            return False
        allowed = CENTER_SLACK_PX + (CENTER_SLACK + PERSPECTIVE_CENTER * share) * side
        if abs(o0 + o1 - i0 - i1) / 2 > slack * allowed:
            return False
    return True


def shades_fit(gray: NDArray[np.uint8], boxes: dict[Level, Box], target: Target) -> bool:
    """Whether the rings inside and around the discs' boxes have the target's shades.

    Args:
        gray: (H, W).
        boxes: With at least one disc's.
        target: Sizes and shades.
    """
    circles = _circles(boxes, target)
    return any(_edges_fit(gray, circles, target, skew) for skew in _SKEWS)


class _Circles(NamedTuple):
    """Where a circle around the target's centre is seen, linear in its radius.

    Two discs tell how perspective shifts and swells the circles; one alone stands for all.
    """

    center_px: NDArray[np.float64]  # (2, 2)
    """Slope [px/m] and value at zero of the centre, for u and v."""
    px_per_m: NDArray[np.float64]  # (2, 2)
    """Slope and value at zero of the half side per metre of radius, for u and v."""

    def at(self, radius_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centre (2,) [px] and scale (2,) [px/m] of the circle with this radius."""
        r = np.array([radius_m, 1.0])
        return r @ self.center_px, r @ self.px_per_m


def _circles(boxes: dict[Level, Box], target: Target) -> _Circles:
    discs = [(target.level_m[k] / 2, b) for k, b in boxes.items() if not _is_square(k, target)]
    radius = np.array([r for r, _ in discs])
    center = np.array([b.center_px for _, b in discs])
    scale = np.array([b.size_px for _, b in discs]) / 2 / radius[:, None]
    if len(discs) == 1:
        still = np.zeros((1, 2))
        return _Circles(np.concatenate((still, center)), np.concatenate((still, scale)))
    return _Circles(np.polyfit(radius, center, 1), np.polyfit(radius, scale, 1))


def _combinations(
    boxes: dict[Level, tuple[Box, ...]], target: Target, size: tuple[int, int]
) -> list[dict[Level, Box]]:
    """All choices of at most one box per level that nest, none empty."""
    fits: dict[tuple[Level, Level], set[tuple[int, int]]] = {}
    for outer, inner in itertools.combinations(Level, 2):
        least = target.level_m[outer] / target.level_m[inner]
        most = least * math.sqrt(2) if _is_square(outer, target) else least
        fits[outer, inner] = {
            (i, j)
            for (i, a), (j, b) in itertools.product(
                enumerate(boxes[outer]), enumerate(boxes[inner])
            )
            if nests(a, b, (least, most), size)
        }
    partial: list[dict[Level, int]] = [{}]
    for level in Level:
        grown = [
            {**chosen, level: k}
            for chosen in partial
            for k in range(len(boxes[level]))
            if all((i, k) in fits[outer, level] for outer, i in chosen.items())
        ]
        partial += grown
    named = ({level: boxes[level][k] for level, k in chosen.items()} for chosen in partial)
    return [c for c in named if len(c) > 1 or _stands_alone(c, target)]


def _stands_alone(chosen: dict[Level, Box], target: Target) -> bool:
    """Whether the only box, if any, is a disc's and sure enough."""
    return any(
        box.score >= SINGLE_LEVEL_SCORE and not _is_square(level, target)
        for level, box in chosen.items()
    )


def _is_square(level: Level, target: Target) -> bool:
    """Whether a level's box circumscribes the board, whose box grows when it rolls."""
    return math.isclose(target.level_m[level], target.board_side_m)


def _edges_fit(gray: NDArray[np.uint8], circles: _Circles, target: Target, skew: float) -> bool:
    """Whether every printed edge that can be seen has the right sign on most rays.

    A circle is taken as the ellipse with this skew in its box.
    """
    angle = np.linspace(0, 2 * np.pi, RAYS, endpoint=False)
    unit = np.stack((np.cos(angle), skew * np.cos(angle) + math.sqrt(1 - skew**2) * np.sin(angle)))
    radii = [target.board_side_m / 2, *(d.diameter_m / 2 for d in target.discs), 0.0]
    shades = [target.board_shade, *(d.shade for d in target.discs)]
    px_per_m = np.hypot(*(unit * circles.at(radii[1])[1][:, None]))
    rings = [
        _ring_gray(gray, circles, unit, outer, inner, shade)
        for (outer, inner), shade in zip(itertools.pairwise(radii), shades, strict=True)
    ]
    edges = 0
    for k in range(len(shades) - 1):
        thin = min(radii[k] - radii[k + 1], radii[k + 1] - radii[k + 2])
        step = rings[k] - rings[k + 1]
        if shades[k] is Shade.BLACK:
            step = -step
        seen = np.isfinite(step) & (thin * px_per_m >= MIN_RING_PX)
        if seen.sum() < MIN_RAYS_SEEN:
            continue
        lighter = np.maximum(rings[k], rings[k + 1])[seen]
        enough = np.maximum(MIN_CONTRAST_LEVELS, MIN_CONTRAST * lighter)
        if (step[seen] > enough).mean() < MIN_RAYS_SHARE:
            return False
        edges += 1
    return edges > 0


def _ring_gray(
    gray: NDArray[np.uint8],
    circles: _Circles,
    unit: NDArray[np.float64],
    outer_m: float,
    inner_m: float,
    shade: Shade,
) -> NDArray[np.float64]:
    """Gray (RAYS,) of a ring along each ray ``unit`` (2, RAYS); NaN where it leaves the picture.

    The mean of a thin ring, whose edges are blurred into it; of a thick one the sample that speaks
    most against its shade, so that a ring of another width does not pass.
    """
    share = (0.3, 0.5, 0.7) if inner_m > 0 else (0.0, 0.3, 0.6)
    points, length = [], np.zeros(unit.shape[1])
    for s in share:
        radius = inner_m + s * (outer_m - inner_m)
        center, scale = circles.at(radius)
        points.append(center[:, None] + radius * unit * scale[:, None])
        length = (outer_m - inner_m) * np.hypot(*(unit * scale[:, None]))
    u, v = np.stack(points, axis=1).astype(np.float32)  # (3, RAYS) each
    height, width = gray.shape
    inside = ((u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)).all(axis=0)
    value = cv2.remap(gray, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    against = value.max(axis=0) if shade is Shade.BLACK else value.min(axis=0)
    gray_of_ring = np.where(length >= THICK_RING_PX, against, value.mean(axis=0))
    return np.where(inside, gray_of_ring, np.nan)
