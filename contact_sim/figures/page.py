"""The page that shows the figures; its sentences are the captions that the figures carry."""

from __future__ import annotations

import os
from pathlib import Path

from contact_sim.errors import FigureError
from contact_sim.figures.catalogue import CATALOGUE, FigureEntry
from contact_sim.figures.style import caption_of, command_of


def page(folder: Path, path: Path) -> str:
    """The page as Markdown, with every figure that lies in the folder.

    Args:
        folder: of the PNG files.
        path: of the page, which links to them from there.

    Raises:
        FigureError: no figure is there, or one that does not say how it was drawn.
    """
    beside = path.parent
    there = [entry for entry in CATALOGUE if _file(folder, entry).exists()]
    if not there:
        raise FigureError(f"no figure in {folder}: draw some first with scripts/figures")
    commands = {entry.name: command_of(_file(folder, entry)) for entry in there}
    lines = [
        "# Figures",
        "",
        "All of them, and this page:",
        "",
        f"`{_of_all(list(commands.values()), folder, path)}`",
        "",
        "Under each is the command that draws it alone, into `runs/figures`. Flights are of the",
        "real client in the simulator, in lockstep: a seed gives the same flight every time. With",
        "`--service` runs 1 and 2 see drawn pictures through a real service. Who looked, and all",
        "numbers in the captions, come from what is drawn.",
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
                f"`{commands[entry.name]}`",
                "",
            ]
    return "\n".join(lines[:-1]) + "\n"


def write_page(path: Path, folder: Path) -> None:
    """Write it, whole or not at all.

    Raises:
        FigureError: no figure is there, or the page cannot be written.
    """
    text = page(folder, path)
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        raise FigureError(f"cannot write {path}: {error.strerror}") from None


def _of_all(commands: list[str], folder: Path, path: Path) -> str:
    """The command that draws all of them again, with the options that they were drawn with."""
    options: dict[str, None] = {}
    for command in commands:
        _, _, said = command.partition(" --")
        options |= dict.fromkeys(f" --{option}" for option in said.split(" --") if option)
    return f"scripts/figures{''.join(options)} --out {folder} --page {path}"


def _file(folder: Path, entry: FigureEntry) -> Path:
    return folder / f"{entry.name}.png"
