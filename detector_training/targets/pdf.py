"""Pages as a PDF of vectors, by matplotlib: the plots need it already, and it draws in inches.

It also embeds the outlines of its own font, so a print looks the same on every machine.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from typing import Any, Literal

from detector_training.errors import TargetPrintError
from detector_training.targets.shapes import (
    Anchor,
    Circle,
    Line,
    Page,
    Polygon,
    Rectangle,
    Shape,
    Text,
)

MM_PER_INCH, POINTS_PER_MM = 25.4, 72 / 25.4
MAX_SIDE_MM = 5080
"""14400 points: the largest page that PDF 1.4 knows (ISO 32000-1, annex C.2)."""
STYLE = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib
    "font.weight": "normal",
    "pdf.compression": 6,
    "pdf.fonttype": 3,
    "pdf.inheritcolor": False,
    "pdf.use14corefonts": False,
    "path.simplify": False,
    "path.effects": [],
    "path.sketch": None,
    "text.usetex": False,
}
"""What a matplotlibrc of the user's could change."""
_ANCHOR: dict[Anchor, Literal["left", "center", "right"]] = {
    "start": "left",
    "middle": "center",
    "end": "right",
}


def pdf_bytes(pages: Sequence[Page], title: str) -> bytes:
    """The pages as a PDF file; the same pages give the same bytes.

    Raises:
        TargetPrintError: a page is larger than a PDF page can be.
    """
    import matplotlib  # takes a second to load: only where something is drawn
    from matplotlib.backends.backend_pdf import PdfPages

    for page in pages:
        if max(page.width_mm, page.height_mm) > MAX_SIDE_MM:
            raise TargetPrintError(
                f"a page of {page.width_mm:.0f} x {page.height_mm:.0f} mm: PDF ends at "
                f"{MAX_SIDE_MM} mm; use --svg, or --paper A1 --tiles"
            )
    out = io.BytesIO()
    told = {"Title": title, "Creator": "detector_training target print", "CreationDate": None}
    with (
        matplotlib.rc_context(STYLE),
        warnings.catch_warnings(),
        PdfPages(out, metadata=told) as pdf,
    ):
        # a name in a script that the font lacks prints as boxes; the print is good without it
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        for page in pages:
            pdf.savefig(_figure(page), facecolor="none", edgecolor="none")
    return out.getvalue()


def _figure(page: Page) -> Any:
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle as Window
    from matplotlib.transforms import Affine2D

    figure = Figure(figsize=(page.width_mm / MM_PER_INCH, page.height_mm / MM_PER_INCH))
    # y down, as in SVG
    flip = Affine2D().scale(1 / MM_PER_INCH, -1 / MM_PER_INCH)
    to_page = flip.translate(0, page.height_mm / MM_PER_INCH) + figure.dpi_scale_trans
    clip = None
    if page.window is not None:
        w = page.window
        clip = Window((w.x_mm, w.y_mm), w.width_mm, w.height_mm, transform=to_page)
    for shapes, inside in ((page.shapes, clip), (page.marks, None)):
        for shape in shapes:
            artist = figure.add_artist(_artist(shape), clip=False)
            artist.set_transform(to_page)
            if inside is not None:
                artist.set_clip_path(inside)
    return figure


def _artist(shape: Shape) -> Any:
    from matplotlib import lines, patches, text

    match shape:
        case Rectangle(x, y, w, h, fill):
            return patches.Rectangle((x, y), w, h, facecolor=fill, linewidth=0)
        case Circle(x, y, diameter, fill):
            return patches.Circle((x, y), diameter / 2, facecolor=fill, linewidth=0)
        case Polygon(corners, fill):
            return patches.Polygon(corners, facecolor=fill, linewidth=0)
        case Line(x0, y0, x1, y1, width, colour, dash):
            # matplotlib gives dashes in multiples of the width
            style = (0, tuple(d / width for d in dash)) if dash else "solid"
            return lines.Line2D(
                (x0, x1),
                (y0, y1),
                color=colour,
                linewidth=width * POINTS_PER_MM,
                linestyle=style,
                solid_capstyle="butt",
                dash_capstyle="butt",
            )
        case Text(x, y, words, size, colour, anchor, bold):
            return text.Text(
                x,
                y,
                words,
                color=colour,
                fontsize=size * POINTS_PER_MM,
                horizontalalignment=_ANCHOR[anchor],
                verticalalignment="baseline",
                fontweight="bold" if bold else "normal",
                parse_math=False,
            )
