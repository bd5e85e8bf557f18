"""All figures, in the order of the page."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, Final, Protocol, cast

from contact_sim.errors import FigureError
from contact_sim.figures.bench import FigureBench


class Draw(Protocol):
    """Draws a figure."""

    def __call__(self, bench: FigureBench) -> tuple[Any, str]:
        """The figure, and its caption with the numbers that it shows."""
        ...


@dataclass(frozen=True, slots=True)
class FigureEntry:
    """A figure; ``name`` is its file's, too."""

    name: str
    title: str
    module: str
    paper: bool
    """The paper has it."""
    of_runs: bool = False
    """It shows runs 1 and 2."""
    drawn: bool = False
    """It needs drawn pictures, and so OpenGL."""
    of_many: bool = False
    """It shows many flights, of a campaign's table or flown for it."""

    def draw(self, bench: FigureBench) -> tuple[Any, str]:
        """Draw it; its module is imported now."""
        module = importlib.import_module(f"contact_sim.figures.{self.module}")
        return cast(Draw, module.draw)(bench)


CATALOGUE: Final = (
    FigureEntry(
        "cbf-boundary", "The boundary and the two runs", "cbf_boundary", paper=True, of_runs=True
    ),
    FigureEntry("barrier", "The barrier over time", "barrier", paper=True, of_runs=True),
    FigureEntry(
        "pose-errors", "Errors in position and yaw", "pose_errors", paper=True, of_runs=True
    ),
    FigureEntry("commands", "Commanded velocities", "commands", paper=True, of_runs=True),
    FigureEntry("fly-by", "Detections past several targets", "fly_by", paper=True, drawn=True),
    FigureEntry(
        "conditions", "Detections in every condition", "conditions", paper=True, drawn=True
    ),
    FigureEntry("contact-map", "Where it touches", "contact_map", paper=False, of_many=True),
    FigureEntry(
        "contact-force",
        "How gently it touches",
        "contact_force",
        paper=False,
        of_runs=True,
        of_many=True,
    ),
    FigureEntry("gate", "Delay and age against the gate", "gate", paper=False),
    FigureEntry("gradients", "The printed gradient, the true one, ours", "gradients", paper=False),
    FigureEntry("film", "A picture of a film", "film", paper=False, drawn=True),
)


def chosen(names: list[str]) -> tuple[FigureEntry, ...]:
    """The figures of these names; all of them where there is none.

    Raises:
        FigureError: there is no figure of a name.
    """
    known = {entry.name: entry for entry in CATALOGUE}
    for name in names:
        if name not in known:
            raise FigureError(f"no figure {name[:40]!r}; there are: {', '.join(known)}")
    return tuple(entry for entry in CATALOGUE if not names or entry.name in names)
