"""What a print consists of: shapes in millimetres, x to the right, y down, colours ``#rrggbb``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

Anchor: TypeAlias = Literal["start", "middle", "end"]
CHARACTER = 0.66
"""Width of a character by its size: what DejaVu Sans takes for the letters of our captions, on
average and then some. Captions are held within their width by it; nothing else depends on it."""


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A filled rectangle; (x, y) is its upper left corner."""

    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float
    fill: str

    def moved(self, dx_mm: float, dy_mm: float) -> Rectangle:
        """The same somewhere else."""
        return replace(self, x_mm=self.x_mm + dx_mm, y_mm=self.y_mm + dy_mm)


@dataclass(frozen=True, slots=True)
class Circle:
    """A filled circle; (x, y) is its centre."""

    x_mm: float
    y_mm: float
    diameter_mm: float
    fill: str

    def moved(self, dx_mm: float, dy_mm: float) -> Circle:
        """The same somewhere else."""
        return replace(self, x_mm=self.x_mm + dx_mm, y_mm=self.y_mm + dy_mm)


@dataclass(frozen=True, slots=True)
class Polygon:
    """A filled polygon."""

    corners_mm: tuple[tuple[float, float], ...]
    fill: str

    def moved(self, dx_mm: float, dy_mm: float) -> Polygon:
        """The same somewhere else."""
        return replace(self, corners_mm=tuple((x + dx_mm, y + dy_mm) for x, y in self.corners_mm))


@dataclass(frozen=True, slots=True)
class Line:
    """A straight stroke, dashed where ``dash_mm`` gives the lengths of ink and gap."""

    x0_mm: float
    y0_mm: float
    x1_mm: float
    y1_mm: float
    width_mm: float
    colour: str
    dash_mm: tuple[float, float] | None = None

    def moved(self, dx_mm: float, dy_mm: float) -> Line:
        """The same somewhere else."""
        return replace(
            self,
            x0_mm=self.x0_mm + dx_mm,
            y0_mm=self.y0_mm + dy_mm,
            x1_mm=self.x1_mm + dx_mm,
            y1_mm=self.y1_mm + dy_mm,
        )


@dataclass(frozen=True, slots=True)
class Text:
    """One line of text; (x, y) lies on its baseline."""

    x_mm: float
    y_mm: float
    text: str
    size_mm: float
    colour: str
    anchor: Anchor = "start"
    bold: bool = False

    def moved(self, dx_mm: float, dy_mm: float) -> Text:
        """The same somewhere else."""
        return replace(self, x_mm=self.x_mm + dx_mm, y_mm=self.y_mm + dy_mm)


Shape: TypeAlias = Rectangle | Circle | Polygon | Line | Text


@dataclass(frozen=True, slots=True)
class Sheet:
    """A drawing of any size, later ones over earlier ones."""

    width_mm: float
    height_mm: float
    shapes: tuple[Shape, ...]


@dataclass(frozen=True, slots=True)
class Page:
    """One page of paper.

    Attributes:
        window: What of the drawing this page shows; None shows all.
        marks: What belongs to the page and not to the drawing; outside of the window too.
    """

    width_mm: float
    height_mm: float
    shapes: tuple[Shape, ...]
    window: Rectangle | None = None
    marks: tuple[Shape, ...] = ()


def fitted(text: str, size_mm: float, width_mm: float) -> float:
    """The size at which a text stays within a width, ``size_mm`` at most."""
    return min(size_mm, width_mm / (CHARACTER * max(1, len(text))))


def millimetres(metres: float) -> str:
    """A length for people, to a hundredth of a millimetre: 0.15 is ``150``."""
    return f"{1000 * metres:.2f}".rstrip("0").rstrip(".")
