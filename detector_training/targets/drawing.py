"""A target as a drawing at true scale, with what a person needs to print, check and hang it."""

from __future__ import annotations

import hashlib
import math

from detector_training.targets.shapes import (
    CHARACTER,
    Anchor,
    Circle,
    Line,
    Polygon,
    Rectangle,
    Shape,
    Sheet,
    Text,
    fitted,
    millimetres,
)
from target_pose.target import Level, Shade, Target

INK, QUIET, HAIR = "#1a1a1a", "#595959", "#808080"
ON_BOARD = {Shade.WHITE: "#9a9a9a", Shade.BLACK: "#666666"}
"""Gray of the small print on the board: to be read at arm's length, and nothing to a camera."""
MARK_MM, GAP_MM = 5.0, 1.0
BLEED_MM = MARK_MM + GAP_MM
HEAD_MM = 9.0
RULER_MM = 100
FOOTER_MM = 47.0
LEAST_WIDTH_MM = 110.0
"""The ruler and its last figure."""


def digest_of(toml: bytes) -> str:
    """What tells two versions of a target's file apart in print: 12 digits of its SHA-256."""
    return hashlib.sha256(toml).hexdigest()[:12]


def draw(target: Target, digest: str, side_marks: bool = True) -> Sheet:
    """The board with cut marks, its name, sizes and a ruler beneath it.

    Args:
        target: What to draw.
        digest: Hash of the target's file, printed on the board and beneath it.
        side_marks: Cut marks to the left and right as well, 6 mm beyond the board; without them
            the cut lines above and below and the outline must do, and the drawing is narrower.
    """
    side = 1000 * target.board_side_m
    width = max(side + (2 * BLEED_MM if side_marks else 0.0), LEAST_WIDTH_MM)
    x, y = (width - side) / 2, HEAD_MM
    name = printable(target.name)
    shapes = [
        *_up(width / 2, HEAD_MM - 2.0, 4.0, QUIET),
        *_board(target, x, y, side),
        *_small_print(target, f"{name}  {digest}", x, y, side),
        *_cut_marks(x, y, side, side_marks),
        *_footer(target, name, digest, max(0.0, min(x, width - LEAST_WIDTH_MM)), y + side, width),
    ]
    return Sheet(width, HEAD_MM + side + BLEED_MM + FOOTER_MM, tuple(shapes))


def printable(name: str) -> str:
    """A name without what cannot be printed (control characters, which XML forbids too)."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)


def _board(target: Target, x: float, y: float, side: float) -> list[Shape]:
    centre = side / 2
    shapes: list[Shape] = [Rectangle(x, y, side, side, target.colours[target.board_shade])]
    shapes += [
        Circle(x + centre, y + centre, 1000 * disc.diameter_m, target.colours[disc.shade])
        for disc in target.discs
    ]
    corners = [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]
    shapes += [
        Line(*corners[i], *corners[(i + 1) % 4], width_mm=0.1, colour=HAIR) for i in range(4)
    ]
    return shapes


def _small_print(target: Target, text: str, x: float, y: float, side: float) -> list[Shape]:
    """Name, hash and up in the corners of the board, which stay when the rest is cut off.

    They are left out where a disc comes near: nothing may touch what the detector looks for.
    """
    pad, size = 0.015 * side, min(4.0, max(2.0, 0.008 * side))
    reach = side / 2 - pad - CHARACTER * size * len(text)
    clear = math.hypot(max(0.0, reach), side / 2 - pad - size)
    if reach < 0 or clear < 500 * target.discs[0].diameter_m + 0.03 * side:
        return []
    colour = ON_BOARD[target.board_shade]
    return [
        Text(x + pad, y + side - pad, text, size, colour),
        *_up(x + pad + 1.5 * size, y + pad + size, size, colour),
    ]


def _up(x: float, y: float, size: float, colour: str) -> list[Shape]:
    """An arrow head and the word, (x, y) in the middle between them on the baseline."""
    left = x - 1.5 * size
    arrow = ((left, y), (left + size, y), (left + size / 2, y - size))
    return [Polygon(arrow, colour), Text(left + 1.3 * size, y, "UP", size, colour, bold=True)]


def _cut_marks(x: float, y: float, side: float, side_marks: bool) -> list[Shape]:
    """Strokes that go on where the board's edges end, for a knife and a steel rule."""
    marks: list[Shape] = []
    for edge in (0.0, side):
        for end, out in ((0.0, -1), (side, 1)):
            near, far = end + out * GAP_MM, end + out * BLEED_MM
            marks.append(Line(x + edge, y + near, x + edge, y + far, 0.25, INK))
            if side_marks:
                marks.append(Line(x + near, y + edge, x + far, y + edge, 0.25, INK))
    return marks


def _footer(
    target: Target, name: str, digest: str, x: float, board_end: float, width: float
) -> list[Shape]:
    y, room = board_end + BLEED_MM + 7.0, width - 2 * x if x > 0 else width
    discs = ", ".join(f"{millimetres(d.diameter_m)} {d.shade}" for d in target.discs)
    side = millimetres(target.board_side_m)
    lines = (
        f"board {side} x {side} mm {target.board_shade}; diameters {discs} mm",
        "boxes  "
        + "   ".join(f"{level} {millimetres(target.level_m[level])} mm" for level in Level),
        f"file {digest} (first digits of the SHA-256 of its TOML)",
        "Print at 100 %, on matte paper; never 'fit to page'.",
        "Cut along the outline: a camera looks for the board's edge. Hang flat, arrow up.",
    )
    shapes: list[Shape] = [Text(x, y, name, fitted(name, 5.5, room), INK, bold=True)]
    for number, line in enumerate(lines):
        shapes.append(Text(x, y + 5.4 + 4.1 * number, line, fitted(line, 2.8, room), QUIET))
    return [*shapes, *_ruler(x, y + 25.6)]


def _ruler(x: float, y: float) -> list[Shape]:
    """100 mm from the middle of the first tick to that of the last."""
    shapes: list[Shape] = [Line(x, y, x + RULER_MM, y, 0.2, INK)]
    for mm in range(RULER_MM + 1):
        length = 5.0 if mm % 10 == 0 else 3.5 if mm % 5 == 0 else 2.0
        shapes.append(Line(x + mm, y, x + mm, y + length, 0.15, INK))
        if mm % 10 == 0:
            anchor: Anchor = "start" if mm == 0 else "middle"
            shapes.append(Text(x + mm, y + 8.0, str(mm), 2.4, INK, anchor))
    told = "100 mm: lay a ruler on it. If it differs, the printer has scaled the page."
    return [*shapes, Text(x, y + 12.5, told, fitted(told, 2.8, RULER_MM), QUIET)]
