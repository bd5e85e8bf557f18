"""Where the outer disc may be, as the detector's boxes tell it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import fmean

from rgbd_wire.camera import CameraIntrinsics
from target_pose.candidate import Box, Candidate
from target_pose.disc_finder import DiscGuess
from target_pose.target import Level, Target

MAX_COORDINATE_PX = 1e5
"""A box that reaches further than this was not made by a detector."""
BORDER_PX = 2.0
"""A box that comes this near to the picture's border may be cut by it."""
MAX_SIDES = 4.0
"""Ratio of a box's sides; a board seen within 72 degrees of its normal has at most 3.2."""


@dataclass(frozen=True, slots=True)
class BoxGuess:
    """The outer disc's outline after one level's box."""

    disc: DiscGuess
    cut: bool
    """The picture's border cuts the box: its size was completed or is not known."""
    sized: bool
    """The width or the height was seen whole."""

    @property
    def width_px(self) -> float:
        """Longer diameter of the disc [px], which tilt does not shorten."""
        return 2 * max(self.disc.semi_axes_px)


def box_guesses(
    candidate: Candidate, target: Target, intrinsics: CameraIntrinsics
) -> list[BoxGuess]:
    """Guesses, the best first: whole boxes, and among those the nearest in size to the disc."""
    diameter_m = target.discs[0].diameter_m
    guesses = []
    for level, box in candidate.boxes.items():
        guess = _guess(box, diameter_m / target.level_m[level], intrinsics)
        if guess is not None:
            guesses.append((guess.cut, _distance(level, target), guess))
    ordered = [guess for *_, guess in sorted(guesses, key=lambda g: g[:2])]
    whole = [guess for guess in ordered if not guess.cut]
    if len(whole) > 1:
        # the boxes are concentric: their mean centre is surer than each
        centers = [guess.disc.center_px for guess in whole]
        middle = (fmean(u for u, _ in centers), fmean(v for _, v in centers))
        disc = DiscGuess(middle, whole[0].disc.semi_axes_px)
        ordered.insert(0, BoxGuess(disc, cut=False, sized=True))
    return ordered


def _distance(level: Level, target: Target) -> float:
    return abs(math.log(target.level_m[level] / target.discs[0].diameter_m))


def _guess(box: Box, ratio: float, intrinsics: CameraIntrinsics) -> BoxGuess | None:
    sides = (box.x0, box.y0, box.x1, box.y1)
    if not all(math.isfinite(s) and abs(s) <= MAX_COORDINATE_PX for s in sides):
        return None
    x0, x1, cut_x = _clip(box.x0, box.x1, intrinsics.width)
    y0, y1, cut_y = _clip(box.y0, box.y1, intrinsics.height)
    if x1 - x0 < 1 or y1 - y0 < 1:
        return None
    sized = not all(cut_x) and not all(cut_y)
    if any(cut_x) or any(cut_y):
        # head-on the box is a square: complete the side that the border cuts
        side = max(x1 - x0, y1 - y0)
        x0, x1 = _complete(x0, x1, cut_x, side)
        y0, y1 = _complete(y0, y1, cut_y, side)
        sized = not (any(cut_x) and any(cut_y))
    a, b = (x1 - x0) * ratio / 2, (y1 - y0) * ratio / 2
    if max(a, b) > MAX_SIDES * min(a, b):
        return None
    center = ((x0 + x1) / 2, (y0 + y1) / 2)
    return BoxGuess(DiscGuess(center, (a, b)), any(cut_x) or any(cut_y), sized)


def _clip(low: float, high: float, size: int) -> tuple[float, float, tuple[bool, bool]]:
    cut = low <= BORDER_PX, high >= size - 1 - BORDER_PX
    return max(low, -0.5), min(high, size - 0.5), cut


def _complete(low: float, high: float, cut: tuple[bool, bool], side: float) -> tuple[float, float]:
    if cut == (True, False):
        return min(low, high - side), high
    if cut == (False, True):
        return low, max(high, low + side)
    return low, high
