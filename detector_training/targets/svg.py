"""A page as SVG: one user unit is a millimetre, every shape an element of its own."""

from __future__ import annotations

from xml.sax.saxutils import escape, quoteattr

from detector_training.targets.shapes import Circle, Line, Page, Polygon, Rectangle, Shape, Text


def svg_text(page: Page, title: str) -> str:
    """The page as an SVG file; the same page gives the same text."""
    width, height = _number(page.width_mm), _number(page.height_mm)
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
            f'viewBox="0 0 {width} {height}">',
            f"<title>{escape(title)}</title>",
            '<g font-family="DejaVu Sans, Verdana, Helvetica, Arial, sans-serif">',
            *(_element(shape) for shape in (*page.shapes, *page.marks)),
            "</g>",
            "</svg>",
            "",
        ]
    )


def _element(shape: Shape) -> str:
    match shape:
        case Rectangle(x, y, w, h, fill):
            return _tag("rect", x=x, y=y, width=w, height=h, fill=fill)
        case Circle(x, y, diameter, fill):
            return _tag("circle", cx=x, cy=y, r=diameter / 2, fill=fill)
        case Polygon(corners, fill):
            points = " ".join(f"{_number(x)},{_number(y)}" for x, y in corners)
            return _tag("polygon", points=points, fill=fill)
        case Line(x0, y0, x1, y1, width, colour, dash):
            more = {"stroke_dasharray": f"{dash[0]} {dash[1]}"} if dash else {}
            return _tag(
                "line", x1=x0, y1=y0, x2=x1, y2=y1, stroke=colour, stroke_width=width, **more
            )
        case Text(x, y, text, size, colour, anchor, bold):
            return (
                _tag(
                    "text",
                    x=x,
                    y=y,
                    font_size=size,
                    fill=colour,
                    text_anchor=anchor,
                    font_weight="bold" if bold else "normal",
                )[:-2]
                + f">{escape(text)}</text>"
            )


def _tag(name: str, **attributes: float | str) -> str:
    told = " ".join(
        f"{key.replace('_', '-')}={quoteattr(v if isinstance(v, str) else _number(v))}"
        for key, v in attributes.items()
    )
    return f"<{name} {told}/>"


def _number(value: float) -> str:
    """To a tenth of a micrometre."""
    return f"{value:.4f}".rstrip("0").rstrip(".") or "0"
