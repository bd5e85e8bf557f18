"""The worst cases to look at: false targets of the highest scores, misses of the widest targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.evaluation.matching import (
    Counting,
    candidate_outcome,
    match,
    true_targets,
)
from detector_training.evaluation.run import Find, confident
from target_pose.candidate import Box
from target_pose.target import Level

TILE_PX = 320
CAPTION_PX = 38
COLUMNS = 4
MOST = 24
"""Pictures on a page; more are not looked at."""
_RGB = {Level.GOOD: (46, 200, 79), Level.BETTER: (60, 150, 255), Level.BEST: (255, 80, 60)}
_TRUE = (255, 220, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One mistake."""

    find: Find
    what: Literal["miss", "false"]
    box: tuple[float, float, float, float]
    """Of the board that was missed, or of the false target [px]."""
    weight: float
    """Visible width of the missed board [px], or the score of the false target."""

    @property
    def caption(self) -> str:
        """One line: what, how bad, in which conditions."""
        sample = self.find.sample
        size = f"{self.weight:.0f} px" if self.what == "miss" else f"score {self.weight:.2f}"
        where = "" if sample.distance_m is None else f" {sample.distance_m:.1f} m"
        noted = [sample.recipe] if sample.recipe else []
        noted += [c for c in sample.conditions if c != sample.recipe]
        return f"{self.what} {size}{where if self.what == 'miss' else ''}: {', '.join(noted)}"


def worst_cases(finds: Sequence[Find], counting: Counting, most: int = MOST) -> tuple[Case, ...]:
    """The mistakes of the candidates: the false ones first, each kind from its worst on."""
    misses, false = [], []
    for find in finds:
        outcome = candidate_outcome(find.sample, find.candidates, counting)
        hit, ignored, taken = match(outcome)
        for k in np.flatnonzero(~hit & ~ignored).tolist():
            candidate = find.candidates[k]
            box = next(iter(candidate.boxes.values()))
            corners = (box.x0, box.y0, box.x1, box.y1)
            false.append(Case(find, "false", corners, candidate.score))
        for m, indices in enumerate(true_targets(find.sample)):
            if outcome.counts[m] and m not in taken:
                x0, y0, x1, y1 = find.sample.boxes[indices[0]].tolist()
                seen = float(find.sample.visible[indices].max())
                misses.append(Case(find, "miss", (x0, y0, x1, y1), (x1 - x0) * seen))
    for cases in (misses, false):
        cases.sort(key=lambda c: -c.weight)
    half = most // 2
    take = min(len(false), max(half, most - len(misses)))
    return (*false[:take], *misses[: most - take])


def draw_case(case: Case) -> NDArray[np.uint8]:
    """The whole picture (H, W, 3) RGB: true boxes yellow, found ones in their level's colour.

    Raises:
        DatasetError: the picture cannot be read any more.
    """
    picture = case.find.sample.read().copy()
    for box in case.find.sample.boxes:
        _rectangle(picture, box.tolist(), _TRUE, 1)
    for level, found in confident(case.find.detections).boxes.items():
        for b in found:
            _rectangle(picture, _corners(b), _RGB[level], 1)
            where = (round(b.x0) + 2, round(b.y1) - 3)
            cv2.putText(picture, f"{b.score:.2f}", where, _FONT, 0.4, _RGB[level], 1, cv2.LINE_AA)
    return picture


def page(cases: Sequence[Case]) -> NDArray[np.uint8]:
    """All cases in tiles (H, W, 3) RGB: cut out around the mistake, captions below.

    Raises:
        DatasetError: a picture cannot be read any more.
    """
    if not cases:
        blank = np.full((120, 2 * TILE_PX, 3), 245, np.uint8)
        cv2.putText(blank, "no misses, no false targets", (20, 66), _FONT, 0.8, (40, 40, 40), 2)
        return blank
    rows = -(-len(cases) // COLUMNS)
    sheet = np.full((rows * (TILE_PX + CAPTION_PX), COLUMNS * TILE_PX, 3), 245, np.uint8)
    for k, case in enumerate(cases):
        top, left = k // COLUMNS * (TILE_PX + CAPTION_PX), k % COLUMNS * TILE_PX
        sheet[top : top + TILE_PX, left : left + TILE_PX] = _tile(case)
        for line, text in enumerate((f"{k + 1} {case.find.sample.image.name}", case.caption)):
            where = (left + 4, top + TILE_PX + 14 + 16 * line)
            cv2.putText(sheet, text[:56], where, _FONT, 0.38, (20, 20, 20), 1, cv2.LINE_AA)
    return sheet


_FONT = cv2.FONT_HERSHEY_SIMPLEX


def _tile(case: Case) -> NDArray[np.uint8]:
    """A square around the mistake, three times its size, at most the whole picture."""
    picture = draw_case(case)
    height, width = picture.shape[:2]
    x0, y0, x1, y1 = case.box
    side = round(float(np.clip(3 * max(x1 - x0, y1 - y0), 96, max(height, width))))
    left, top = round((x0 + x1 - side) / 2), round((y0 + y1 - side) / 2)
    left = int(np.clip(left, min(0, width - side), max(0, width - side)))
    top = int(np.clip(top, min(0, height - side), max(0, height - side)))
    square = np.full((side, side, 3), 128, np.uint8)
    part = picture[max(0, top) : top + side, max(0, left) : left + side]
    dy, dx = max(0, -top), max(0, -left)
    square[dy : dy + part.shape[0], dx : dx + part.shape[1]] = part
    how = cv2.INTER_NEAREST if side < TILE_PX else cv2.INTER_AREA
    return np.asarray(cv2.resize(square, (TILE_PX, TILE_PX), interpolation=how), np.uint8)


def _rectangle(
    picture: NDArray[np.uint8], xyxy: Sequence[float], rgb: tuple[int, ...], thick: int
) -> None:
    x0, y0, x1, y1 = (round(float(np.clip(v, -9000, 9000))) for v in xyxy)
    cv2.rectangle(picture, (x0, y0), (x1, y1), rgb, thick)


def _corners(box: Box) -> tuple[float, float, float, float]:
    return box.x0, box.y0, box.x1, box.y1
