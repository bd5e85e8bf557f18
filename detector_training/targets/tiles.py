"""A drawing cut into pages that overlap, with the marks to put it together again.

Each page but those of the first row and column is cut along its dashed edges and laid on its
neighbours, so that its edge comes to lie on their dotted line.
"""

from __future__ import annotations

import math

from detector_training.targets.shapes import Line, Page, Rectangle, Shape, Sheet, Text, fitted

OVERLAP_MM = 10.0
STRIP_MM = 6.0
"""Below the picture, for the page's label; the page below covers it."""
MAX_PAGES = 100
GRAY = "#808080"
"""Seen on white and on black."""


def tile_grid(sheet: Sheet, size_mm: tuple[float, float], margin_mm: float) -> tuple[int, int]:
    """How many rows and columns of pages a drawing takes."""
    width, height = _window(size_mm, margin_mm)
    return _count(sheet.height_mm, height), _count(sheet.width_mm, width)


def cut_into_tiles(
    sheet: Sheet, name: str, size_mm: tuple[float, float], margin_mm: float
) -> tuple[Page, ...]:
    """The pages of a drawing, row by row."""
    rows, columns = tile_grid(sheet, size_mm, margin_mm)
    width, height = _window(size_mm, margin_mm)
    pages = []
    for row in range(rows):
        for column in range(columns):
            dx = margin_mm - column * (width - OVERLAP_MM)
            dy = margin_mm - row * (height - OVERLAP_MM)
            window = Rectangle(margin_mm, margin_mm, width, height, "#ffffff")
            label = f"{name}: row {row + 1}, column {column + 1} of {rows} x {columns}"
            todo = _todo(row, column, rows, columns)
            pages.append(
                Page(
                    *size_mm,
                    tuple(shape.moved(dx, dy) for shape in sheet.shapes),
                    window,
                    (*_label(window, label, todo), *_guides(window, row, column, rows, columns)),
                )
            )
    return tuple(pages)


def _window(size_mm: tuple[float, float], margin_mm: float) -> tuple[float, float]:
    return size_mm[0] - 2 * margin_mm, size_mm[1] - 2 * margin_mm - STRIP_MM


def _count(length: float, window: float) -> int:
    return max(1, math.ceil((length - OVERLAP_MM) / (window - OVERLAP_MM) - 1e-9))


def _todo(row: int, column: int, rows: int, columns: int) -> str:
    edges = [edge for edge, there in (("left", column > 0), ("top", row > 0)) if there]
    if not edges:
        return "this page lies at the bottom"
    return f"cut along the dashes ({' and '.join(edges)}), lay on the dots of the page before"


def _label(window: Rectangle, label: str, todo: str) -> tuple[Shape, Shape]:
    y = window.y_mm + window.height_mm + 4.5
    half = window.width_mm / 2 - 2
    end = window.x_mm + window.width_mm
    return (
        Text(window.x_mm, y, label, fitted(label, 3.0, half), "#1a1a1a", bold=True),
        Text(end, y, todo, fitted(todo, 2.6, half), "#595959", "end"),
    )


def _guides(window: Rectangle, row: int, column: int, rows: int, columns: int) -> list[Shape]:
    x0, y0 = window.x_mm, window.y_mm
    x1, y1 = x0 + window.width_mm, y0 + window.height_mm
    cut, seam = (4.0, 2.0), (0.4, 1.2)
    guides: list[Shape] = []
    if column > 0:
        guides.append(Line(x0, y0, x0, y1, 0.2, GRAY, cut))
    if row > 0:
        guides.append(Line(x0, y0, x1, y0, 0.2, GRAY, cut))
    if column < columns - 1:
        guides.append(Line(x1 - OVERLAP_MM, y0, x1 - OVERLAP_MM, y1, 0.2, GRAY, seam))
    if row < rows - 1:
        guides.append(Line(x0, y1 - OVERLAP_MM, x1, y1 - OVERLAP_MM, 0.2, GRAY, seam))
    return guides
