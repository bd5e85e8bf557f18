"""The page that shows the figures; its sentences are the captions that the figures carry."""

from __future__ import annotations

import os
from pathlib import Path

from contact_sim.errors import FigureError
from contact_sim.figures.catalogue import CATALOGUE, FigureEntry
from contact_sim.figures.style import caption_of


def page(folder: Path, beside: Path) -> str:
    """The page as Markdown, with every figure that lies in the folder.

    Args:
        folder: of the PNG files.
        beside: folder of the page, which links to them from there.

    Raises:
        FigureError: no figure is there.
    """
    there = [entry for entry in CATALOGUE if _file(folder, entry).exists()]
    if not there:
        raise FigureError(f"no figure in {folder}: draw some first with scripts/figures")
    lines = [
        "# Figures",
        "",
        "`scripts/figures --page docs/results/figures.md` draws them all, `scripts/figures NAME`",
        "one; with `--service` the two runs see drawn pictures through a real service, as their",
        "captions say. Flights are of the real client in the simulator, in lockstep: a seed",
        "gives the same flight every time. The numbers in the captions come from what is drawn.",
        "",
    ]
    for heading, paper in (("The paper's", True), ("Beyond the paper", False)):
        mine = [entry for entry in there if entry.paper is paper]
        lines += [f"## {heading}", ""] if mine else []
        for entry in mine:
            path = _file(folder, entry)
            link = Path(os.path.relpath(path, beside)).as_posix()
            lines += [
                f"### {entry.title}",
                "",
                f"![{entry.title}]({link})",
                "",
                caption_of(path),
                "",
                f"`scripts/figures {entry.name}`",
                "",
            ]
    return "\n".join(lines[:-1]) + "\n"


def write_page(path: Path, folder: Path) -> None:
    """Write it, whole or not at all.

    Raises:
        FigureError: no figure is there, or the page cannot be written.
    """
    text = page(folder, path.parent)
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        raise FigureError(f"cannot write {path}: {error.strerror}") from None


def _file(folder: Path, entry: FigureEntry) -> Path:
    return folder / f"{entry.name}.png"
