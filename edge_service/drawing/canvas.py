"""Anti-aliased lines and text on an RGB picture, at parts of a pixel, whatever the coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Rgb: TypeAlias = tuple[int, int, int]

BACKGROUND: Rgb = (24, 26, 30)
FOREGROUND: Rgb = (235, 235, 235)
FAINT: Rgb = (130, 134, 142)
FONT = cv2.FONT_HERSHEY_SIMPLEX
_FONT_HEIGHT_PX = 21.0
"""Of a capital letter of this font at scale one."""
_SHIFT = 4
"""Bits of a pixel's fraction that OpenCV draws with."""
_FARTHEST_PX = 30_000.0
"""Past it a coordinate would not fit OpenCV's integers; nothing there is seen anyway."""
DASH_PX, GAP_PX = 7.0, 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """A part of a picture with its own coordinates: canvas = (uv - origin + 0.5) scale - 0.5."""

    pixels: NDArray[np.uint8]  # (H, W, 3)
    """RGB; drawn into."""
    origin: tuple[float, float] = (0.0, 0.0)
    """What lies at the canvas' first pixel [px of the colour picture]."""
    scale: float = 1.0
    """Canvas pixels per pixel of the colour picture."""

    def at(self, uv: Array) -> Array:
        """Canvas coordinates (..., 2) of pixels (..., 2) of the colour picture."""
        return np.asarray((uv - self.origin + 0.5) * self.scale - 0.5)

    def line(
        self, xy: Array, color: Rgb, *, width: int = 1, closed: bool = False, halo: bool = False
    ) -> None:
        """A line through points (N, 2); where one is not finite it is interrupted."""
        for part in _runs(xy, closed):
            if halo:
                self._polyline(part, (0, 0, 0), width + 2)
            self._polyline(part, color, width)

    def dashes(self, xy: Array, color: Rgb, *, width: int = 1, closed: bool = False) -> None:
        """A dashed line through points (N, 2)."""
        for part in _runs(xy, closed):
            for dash in _dashes(part):
                self._polyline(dash, color, width)

    def arrow(self, tail: Array, tip: Array, color: Rgb, width: int = 2) -> None:
        """An arrow from one point (2,) to another."""
        if not np.isfinite([tail, tip]).all():
            return
        way = tip - tail
        length = float(np.hypot(*way))
        self.line(np.stack([tail, tip]), color, width=width, halo=True)
        if length < 1:
            return
        back = way / length * min(10.0, 0.4 * length)
        side = np.array([-back[1], back[0]]) * 0.5
        head = np.stack([tip - back + side, tip, tip - back - side])
        self.line(head, color, width=width, halo=True)

    def dots(self, xy: Array, color: Rgb, radius: float) -> None:
        """A filled circle at each point (N, 2)."""
        for x, y in _fixed(xy[np.isfinite(xy).all(axis=1)]):
            radius_fixed = max(round(radius * 2**_SHIFT), 2**_SHIFT)
            cv2.circle(self.pixels, (x, y), radius_fixed, color, -1, cv2.LINE_AA, _SHIFT)

    def crosses(self, xy: Array, color: Rgb, radius: float) -> None:
        """A small x at each point (N, 2)."""
        for point in xy[np.isfinite(xy).all(axis=1)]:
            for lean in (1.0, -1.0):
                arm = radius * np.array([1.0, lean])
                self._polyline(np.stack([point - arm, point + arm]), color, 1)

    def area(self, xy: Array, color: Rgb, opacity: float) -> None:
        """A filled polygon (N, 2), seen through."""
        if not np.isfinite(xy).all():
            return
        over = self.pixels.copy()
        cv2.fillPoly(over, [_fixed(xy)], color, cv2.LINE_AA, _SHIFT)
        cv2.addWeighted(over, opacity, self.pixels, 1 - opacity, 0, self.pixels)

    def text(
        self,
        words: str,
        at: tuple[float, float],
        color: Rgb = FOREGROUND,
        height: float = 12.0,
        *,
        halo: bool = True,
    ) -> None:
        """Words whose capitals are ``height`` tall, ``at`` the left end of their base line."""
        words = printable(words)
        scale, thick = height / _FONT_HEIGHT_PX, max(1, round(height / 10))
        place = (round(min(max(at[0], -1e4), 1e4)), round(min(max(at[1], -1e4), 1e4)))
        if halo:
            # the same letters about the place: thicker ones would have another width
            for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1), (1, 1)):
                around = (place[0] + dx, place[1] + dy)
                cv2.putText(self.pixels, words, around, FONT, scale, (0, 0, 0), thick, cv2.LINE_AA)
        cv2.putText(self.pixels, words, place, FONT, scale, color, thick, cv2.LINE_AA)

    def _polyline(self, xy: Array, color: Rgb, width: int) -> None:
        cv2.polylines(self.pixels, [_fixed(xy)], False, color, width, cv2.LINE_AA, _SHIFT)


def text_width(words: str, height: float) -> int:
    """How wide such words are [px]."""
    scale, thick = height / _FONT_HEIGHT_PX, max(1, round(height / 10))
    return int(cv2.getTextSize(printable(words), FONT, scale, thick)[0][0])


def wrapped(words: str, height: float, width: int) -> list[str]:
    """Words broken into lines that are at most so wide [px]."""
    lines: list[str] = []
    for word in words.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and text_width(longer, height) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def printable(words: str) -> str:
    """The font has no more than ASCII."""
    return words.encode("ascii", "replace").decode("ascii")


def _fixed(xy: Array) -> NDArray[np.int32]:
    clipped = np.clip(xy, -_FARTHEST_PX, _FARTHEST_PX)
    return np.asarray(np.round(clipped * 2**_SHIFT), dtype=np.int32)


def _runs(xy: Array, closed: bool) -> list[Array]:
    """The stretches (M, 2) of a line (N, 2) whose points are all finite, two points or more."""
    if closed and len(xy):
        xy = np.concatenate([xy, xy[:1]])
    known = np.isfinite(xy).all(axis=1)
    cuts = np.flatnonzero(np.diff(known.astype(np.int8))) + 1
    return [run for run in np.split(xy, cuts) if len(run) > 1 and np.isfinite(run).all()]


def _dashes(xy: Array) -> list[Array]:
    """The dashes of a line (N, 2): each from its start to its end along the line."""
    clipped = np.clip(xy, -_FARTHEST_PX, _FARTHEST_PX)
    steps = np.hypot(*np.diff(clipped, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    total = float(along[-1])
    count = min(math.ceil(total / (DASH_PX + GAP_PX)), 2000)
    dashes = []
    for start in np.arange(count) * (DASH_PX + GAP_PX):
        at = np.linspace(start, min(start + DASH_PX, total), 4)
        dashes.append(np.stack([np.interp(at, along, clipped[:, i]) for i in (0, 1)], axis=1))
    return dashes
