"""From boxes to targets: the levels of one target nest, have known size ratios and known shades.

A net fires on things that look alike: other ring markers, white discs on black, wheels, washers.
Two checks throw them out. *Geometry*: the boxes are concentric and their sizes have the target's
ratios, as far as tilt (to 70 degrees), perspective, a few pixels of error and a cut by the border
allow. *Shades*: along rays from the centre, each printed ring is darker or lighter than its
neighbour as the target's file says, whatever the light.

An arm in front of a large board makes the net draw a box too small: two of three fit, the third
does not quite. It still says that the net saw its level: it counts in the score, though not among
the candidate's boxes, where the picture itself shows rings of the right widths and shades.

A target of points alone has one level, in which nothing nests: there each box is a candidate, and
the localiser looks whether its points are where a pose would put them (``pnp_points``).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from target_pose.candidate import Box, Candidate, Detections
from target_pose.points import PointPx
from target_pose.rings import is_board, shades_share
from target_pose.target import Level, Target

MAX_BOXES = 20
"""Boxes of one level that are looked at, best first: bounds the time in any picture."""

SIZE_SLACK_PX, SIZE_SLACK = 2.0, 0.10
"""Error of a box's side: pixels, and a share of the outer side."""
LOOSE_SIZE_SLACK = 0.20
"""Share of its side by which an outer box may be too small and yet speak for its level. In eight
simulated flights the arm at the board's middle made it 0.10 to 0.19; 0.3 found no more."""
CENTER_SLACK_PX, CENTER_SLACK = 2.0, 0.06
"""Likewise of its centre."""
PERSPECTIVE_CENTER, PERSPECTIVE_SIZE = 0.30, 0.45
"""How far boxes of concentric shapes shift and swell in perspective, for a target as large as the
picture; in proportion for smaller ones (20 000 projected poses stay inside)."""
CUT_SLACK = 2.5
"""All slack grows by this along an axis on which the border cuts a box: the net has to guess."""

EXPECTED_PX = 8.0
"""A level of fewer pixels need not be found."""

MIN_SHADES_SHARE = 0.5
"""Least share of rays on which the rings have the right shades: boxes alone convince nobody."""

LOOSE_SHADES_SHARE = 0.8
"""Likewise where one box of three nests but loosely. Chosen on 2900 rendered pictures of the
validation split, 1600 of them full of look-alikes: no false target was added from 0.7 on, one at
0.5. All 75 pictures of those flights that were lost near the board are found, at 0.9 one fewer."""

SHADES_WEIGHT = 0.3
"""What right shades on all rays are worth, beside the net's own score of at most one."""

MIN_SCORE = 0.9 / (1 + SHADES_WEIGHT)
"""Least score of a candidate. A net that is sure outweighs an arm in front of a third of the rings;
right shades on every ray do not make up for a net that doubts. Chosen on 3100 rendered pictures
that are kept for such choices: 21 of them with a false target where two thresholds apart had 54."""

MAX_CHECKS = 20
"""Groups of boxes whose shades are looked at, best first: bounds the time in any picture."""


def group(
    detections: Detections, target: Target, color_rgb: NDArray[np.uint8]
) -> tuple[Candidate, ...]:
    """The targets among a picture's boxes, best first; none has its centre in a better one.

    One level may be missing (too small when far, out of the picture when near); a lone box is no
    target, however sure, unless the target has no discs.

    Args:
        detections: Boxes per level, best first.
        target: Sizes and shades.
        color_rgb: (H, W, 3), the picture of the boxes.
    """
    if not target.discs:
        return _lone(detections, target)
    size = (color_rgb.shape[1], color_rgb.shape[0])
    boxes = {level: detections.boxes.get(level, ())[:MAX_BOXES] for level in Level}
    proposals = [
        p for p in _proposals(boxes, target, size) if _with_shades(p.score, 1.0) >= MIN_SCORE
    ]
    # More levels first: three boxes of a target outweigh any two of them
    proposals.sort(key=lambda p: p.score, reverse=True)
    gray = cv2.cvtColor(color_rgb, cv2.COLOR_RGB2GRAY) if proposals else None
    found: list[Candidate] = []
    for score, chosen, least_share in proposals[:MAX_CHECKS]:
        if any(_same_place(chosen, other) for other in found):
            continue
        assert gray is not None
        share = shades_share(np.asarray(gray, np.uint8), chosen, target)
        both = _with_shades(score, share)
        if share >= least_share and both >= MIN_SCORE:
            surest = max(chosen.values(), key=lambda box: box.score)
            found.append(Candidate(chosen, both, _by_name(surest, target)))
    return tuple(sorted(found, key=lambda c: c.score, reverse=True))


def _lone(detections: Detections, target: Target) -> tuple[Candidate, ...]:
    """Each box that has the target's points, best first."""
    found: list[Candidate] = []
    for box in detections.boxes.get(Level.GOOD, ())[:MAX_BOXES]:
        points = _by_name(box, target)
        boxes = {Level.GOOD: box}
        if points and not any(_same_place(boxes, other) for other in found):
            found.append(Candidate(boxes, box.score, points))
    return tuple(found)


def _by_name(box: Box, target: Target) -> Mapping[str, PointPx]:
    """The labelled points that the net gave with a box; none unless it gave all."""
    if not box.points or len(box.points) != len(target.points):
        return {}
    return {point.name: seen for point, seen in zip(target.points, box.points, strict=True)}


def _with_shades(score: float, shades_share: float) -> float:
    """What the net and the rings' shades say together, in [0, 1]."""
    return (score + SHADES_WEIGHT * shades_share) / (1 + SHADES_WEIGHT)


def nests(
    outer: Box,
    inner: Box,
    ratio: tuple[float, float],
    image_size: tuple[int, int],
    too_small: float = SIZE_SLACK,
) -> bool:
    """Whether two boxes may circumscribe concentric shapes of one board.

    Args:
        outer: Box of the larger shape.
        inner: Box of the smaller one.
        ratio: Least and largest ratio of their sides without perspective.
        image_size: Width and height of the picture [px].
        too_small: Share of its side that the outer box may lack.
    """
    share = min(max(outer.size_px) / max(image_size), 1.0)
    ends = ((outer.x0, inner.x0, outer.x1, inner.x1), (outer.y0, inner.y0, outer.y1, inner.y1))
    for axis, (o0, i0, o1, i1) in enumerate(ends):
        cut = min(o0, i0) < 0 or max(o1, i1) > image_size[axis] - 1
        slack = CUT_SLACK if cut else 1.0
        side, inner_side = o1 - o0, i1 - i0
        least = ratio[0] * inner_side - slack * (SIZE_SLACK_PX + too_small * side)
        most = ratio[1] * (1 + PERSPECTIVE_SIZE * share) * inner_side
        if not least <= side <= most + slack * (SIZE_SLACK_PX + SIZE_SLACK * side):
            return False
        allowed = CENTER_SLACK_PX + (CENTER_SLACK + PERSPECTIVE_CENTER * share) * side
        if abs(o0 + o1 - i0 - i1) / 2 > slack * allowed:
            return False
    return True


class _Proposal(NamedTuple):
    """Boxes that may be those of one target."""

    score: float
    """The net's, before the shades are looked at."""
    boxes: dict[Level, Box]
    least_share: float
    """Share of rays on which the rings' shades have to be right."""


_Fits: TypeAlias = dict[tuple[Level, Level], set[tuple[int, int]]]
"""Of an outer and an inner level: the pairs of boxes that nest, by their places in the lists."""


def _proposals(
    boxes: dict[Level, tuple[Box, ...]], target: Target, size: tuple[int, int]
) -> list[_Proposal]:
    """Boxes that nest; then pairs of them that do, with a third one that does but loosely."""
    # What nests, nests loosely, too
    loose = _fits(boxes, target, size, LOOSE_SIZE_SLACK)
    fits = _fits(boxes, target, size, SIZE_SLACK, among=loose)
    nested = _combinations(boxes, fits)
    made = [(chosen, chosen, MIN_SHADES_SHARE) for chosen in nested]
    for chosen in nested if loose != fits else ():
        for level in (k for k in Level if k not in chosen):
            near = (
                k
                for k in range(len(boxes[level]))
                if _all_fit(chosen, level, k, loose) and not _all_fit(chosen, level, k, fits)
            )
            if (surest := next(near, None)) is not None:
                made.append((chosen, {**chosen, level: surest}, LOOSE_SHADES_SHARE))
    return [
        _Proposal(_score(_named(counted, boxes), target, size), _named(chosen, boxes), share)
        for chosen, counted, share in made
    ]


def _named(chosen: dict[Level, int], boxes: dict[Level, tuple[Box, ...]]) -> dict[Level, Box]:
    return {level: boxes[level][k] for level, k in chosen.items()}


def _fits(
    boxes: dict[Level, tuple[Box, ...]],
    target: Target,
    size: tuple[int, int],
    too_small: float,
    among: _Fits | None = None,
) -> _Fits:
    """The pairs that nest; of these pairs alone, if some are given."""
    fits: _Fits = {}
    for outer, inner in itertools.combinations(Level, 2):
        least = target.level_m[outer] / target.level_m[inner]
        most = least * math.sqrt(2) if is_board(outer, target) else least
        pairs: Iterable[tuple[int, int]] = (
            itertools.product(range(len(boxes[outer])), range(len(boxes[inner])))
            if among is None
            else among[outer, inner]
        )
        fits[outer, inner] = {
            (i, j)
            for i, j in pairs
            if nests(boxes[outer][i], boxes[inner][j], (least, most), size, too_small)
        }
    return fits


def _all_fit(chosen: dict[Level, int], level: Level, k: int, fits: _Fits) -> bool:
    """Whether a level's box nests with the chosen ones of other levels."""
    return all(
        (i, k) in fits[other, level] if (other, level) in fits else (k, i) in fits[level, other]
        for other, i in chosen.items()
    )


def _combinations(boxes: dict[Level, tuple[Box, ...]], fits: _Fits) -> list[dict[Level, int]]:
    """All choices of at most one box per level, at least two in all, that nest."""
    partial: list[dict[Level, int]] = [{}]
    for level in Level:
        partial += [
            {**chosen, level: k}
            for chosen in partial
            for k in range(len(boxes[level]))
            if _all_fit(chosen, level, k, fits)
        ]
    return [chosen for chosen in partial if len(chosen) > 1]


def _score(boxes: dict[Level, Box], target: Target, image_size: tuple[int, int]) -> float:
    """Mean score of the levels that are there to be found; a missing one counts as zero.

    From afar the innermost disc is a few pixels, from near the board lies outside of the picture:
    that such a level was not found says nothing.
    """
    outermost = next(level for level in Level if level in boxes)
    seen = boxes[outermost]
    px_per_m = max(seen.size_px) / target.level_m[outermost]
    expected = 0
    for level in Level:
        side = target.level_m[level] * px_per_m
        visible = side >= EXPECTED_PX and _inside(seen.center_px, side, image_size) >= 0.5
        expected += level in boxes or visible
    return sum(b.score for b in boxes.values()) / expected


def _inside(center_px: tuple[float, float], side_px: float, image_size: tuple[int, int]) -> float:
    """Share of a square's area that lies in the picture."""
    share = 1.0
    for c, size in zip(center_px, image_size, strict=True):
        low, high = max(c - side_px / 2, -0.5), min(c + side_px / 2, size - 0.5)
        share *= max(high - low, 0.0) / side_px
    return share


def _same_place(boxes: dict[Level, Box], better: Candidate) -> bool:
    """Whether a candidate's centre lies in the outermost box of a better one."""
    u, v = next(iter(boxes.values())).center_px
    outermost = next(iter(better.boxes.values()))
    return outermost.x0 <= u <= outermost.x1 and outermost.y0 <= v <= outermost.y1
