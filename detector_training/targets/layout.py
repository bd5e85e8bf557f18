"""A drawing on paper: on one page as large as needed, on one of a size, or cut into several."""

from __future__ import annotations

import math
from enum import StrEnum

from detector_training.errors import TargetPrintError
from detector_training.targets.drawing import draw, printable
from detector_training.targets.shapes import Page, Sheet
from detector_training.targets.tiles import MAX_PAGES, cut_into_tiles, tile_grid
from target_pose.target import Target

MAX_MARGIN_MM = 50.0


class Paper(StrEnum):
    """What to print on."""

    FIT = "fit"
    A4 = "A4"
    LETTER = "letter"
    A3 = "A3"
    A2 = "A2"
    A1 = "A1"


SIZE_MM = {
    Paper.A4: (210.0, 297.0),
    Paper.LETTER: (215.9, 279.4),
    Paper.A3: (297.0, 420.0),
    Paper.A2: (420.0, 594.0),
    Paper.A1: (594.0, 841.0),
}
"""Width and height upright, from the smallest to the largest (ISO 216; ANSI Y14.1)."""


def lay_out(
    target: Target, digest: str, paper: Paper, margin_mm: float, tiles: bool = False
) -> tuple[Page, ...]:
    """The pages to print.

    Args:
        target: What to print.
        digest: Hash of its file, for the captions.
        paper: What it is printed on, upright or lying: whichever fits, or takes fewer pages.
        margin_mm: What the printer leaves blank at each edge of the paper.
        tiles: Cut into several pages what does not fit on one.

    Raises:
        TargetPrintError: it does not fit; names the paper that it fits on.
    """
    if not (math.isfinite(margin_mm) and 0 <= margin_mm <= MAX_MARGIN_MM):
        raise TargetPrintError(f"margin of {margin_mm} mm: give 0 to {MAX_MARGIN_MM:g}")
    if paper is Paper.FIT:
        if tiles:
            raise TargetPrintError("tiles of what size? name a --paper")
        sheet = draw(target, digest)
        size = (sheet.width_mm + 2 * margin_mm, sheet.height_mm + 2 * margin_mm)
        return (_centred(sheet, size),)
    page = _one_page(target, digest, paper, margin_mm)
    if page is not None:
        return (page,)
    if tiles:
        return _tiled(target, digest, paper, margin_mm)
    fits = [p for p in SIZE_MM if _one_page(target, digest, p, margin_mm) is not None]
    advice = f"--paper {fits[0]}" if fits else "--paper fit (no paper up to A1 is large enough)"
    need = draw(target, digest, side_marks=False)
    raise TargetPrintError(
        f"{printable(target.name)} with its captions is {need.width_mm:g} x {need.height_mm:g} mm "
        f"and does not fit on {paper} with margins of {margin_mm:g} mm; use {advice} or --tiles"
    )


def _one_page(target: Target, digest: str, paper: Paper, margin_mm: float) -> Page | None:
    """The drawing on one page, with as many marks and as upright as it fits."""
    for side_marks in (True, False):
        sheet = draw(target, digest, side_marks)
        for width, height in _orientations(paper):
            # a hair of tolerance: 0.2 m is no whole number of millimetres in binary
            if (
                sheet.width_mm <= width - 2 * margin_mm + 1e-6
                and sheet.height_mm <= height - 2 * margin_mm + 1e-6
            ):
                return _centred(sheet, (width, height))
    return None


def _tiled(target: Target, digest: str, paper: Paper, margin_mm: float) -> tuple[Page, ...]:
    # the fewest pages; among equals with all marks, and upright
    ways = [
        (tile_grid(sheet, size, margin_mm), sheet, size)
        for sheet in (draw(target, digest), draw(target, digest, side_marks=False))
        for size in _orientations(paper)
    ]
    (rows, columns), sheet, size = min(ways, key=lambda way: math.prod(way[0]))
    if rows * columns > MAX_PAGES:
        raise TargetPrintError(
            f"{printable(target.name)} on {paper} takes {rows * columns} pages, more than "
            f"{MAX_PAGES}; name a larger --paper, or use --paper fit"
        )
    return cut_into_tiles(sheet, printable(target.name), size, margin_mm)


def _orientations(paper: Paper) -> tuple[tuple[float, float], tuple[float, float]]:
    width, height = SIZE_MM[paper]
    return (width, height), (height, width)


def _centred(sheet: Sheet, size: tuple[float, float]) -> Page:
    dx, dy = (size[0] - sheet.width_mm) / 2, (size[1] - sheet.height_mm) / 2
    return Page(*size, tuple(shape.moved(dx, dy) for shape in sheet.shapes))
