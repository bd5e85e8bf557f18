"""``target``: which targets there are, what they measure, and a print of one at true scale."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from detector_training.commands.shell import console
from detector_training.datasets.output import write_file
from detector_training.errors import TargetPrintError
from detector_training.targets.drawing import digest_of, printable
from detector_training.targets.layout import Paper, lay_out
from detector_training.targets.pdf import pdf_bytes
from detector_training.targets.reach import LEAST_PX, reach
from detector_training.targets.shapes import millimetres
from detector_training.targets.svg import svg_text
from target_pose.errors import TargetFileError
from target_pose.target import (
    Target,
    load_round_target,
    load_target,
    packaged_targets,
    target_file,
)

Name = Annotated[
    str, typer.Argument(metavar="NAME", help="A packaged target, or the path of your own .toml.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]

target = typer.Typer(
    help="List the targets, show what one measures, print it at true scale.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def register(app: typer.Typer) -> None:
    """Add ``target`` to a command line."""
    app.add_typer(target, name="target")


@target.command("list")
def list_targets(as_json: AsJson = False) -> None:
    """List the targets that come with the package.

    For your own, copy a file of theirs, change its sizes and give the path wherever a name goes.

    Example: python -m detector_training target list
    """
    found = [(name, load_target(name)) for name in packaged_targets()]
    if as_json:
        typer.echo(json.dumps([_as_json(name, t) for name, t in found], indent=1))
        return
    table = Table("target", "board \\[mm]", "discs \\[mm]", "boxes \\[mm]")
    for name, t in found:
        discs = ", ".join(millimetres(d.diameter_m) for d in t.discs)
        boxes = ", ".join(f"{level} {millimetres(side)}" for level, side in t.level_m.items())
        table.add_row(name, millimetres(t.board_side_m), discs, boxes)
    Console().print(table)  # the shared one is for what is no result


@target.command()
def show(
    name: Name,
    fx: Annotated[
        float, typer.Option(min=1, max=100_000, help="The camera's focal length in pixels.")
    ] = 385.0,
    width: Annotated[int, typer.Option(min=16, max=65536, help="Width of its pictures.")] = 640,
    height: Annotated[int, typer.Option(min=16, max=65536, help="Height of its pictures.")] = 480,
    as_json: AsJson = False,
) -> None:
    """Show what a target measures and from how far a camera sees it.

    The focal length that is assumed is about that of a RealSense D455 at 640x480.

    Example: python -m detector_training target show bullseye-400 --fx 910 --width 1280 --height 720
    """
    shape = load_target(name)
    far_m, near_m = reach(shape, fx, width, height)
    if as_json:
        camera = {"fx_px": fx, "width_px": width, "height_px": height}
        seen = {"camera": camera, "board_14px_m": far_m, "board_fills_picture_m": near_m}
        typer.echo(json.dumps(_as_json(name, shape) | seen, indent=1))
        return
    table = Table("what", "size \\[mm]", "printed in", title=printable(shape.name))
    board = f"{shape.board_shade} {shape.colours[shape.board_shade]}"
    table.add_row("board (side)", millimetres(shape.board_side_m), board)
    for disc in shape.discs:
        colour = f"{disc.shade} {shape.colours[disc.shade]}"
        table.add_row("disc (diameter)", millimetres(disc.diameter_m), colour)
    for level, side_m in shape.level_m.items():
        table.add_row(f"{level} (box)", millimetres(side_m), "")
    for point in shape.points:
        place = f"{1000 * point.y_m:+g} right, {1000 * point.z_m:+g} up"
        table.add_row(f"point {point.name}", place, "")
    out = Console()
    out.print(table)
    out.print(
        f"file {target_file(name)}, hash {_digest(name)}\n"
        f"with fx = {fx:g} px in {width}x{height}: the board is {LEAST_PX:g} px wide at "
        f"{far_m:.2f} m and fills the picture at {near_m:.2f} m",
        soft_wrap=True,
        markup=False,
        highlight=False,
    )


@target.command("print")
def print_target(
    name: Name,
    pdf: Annotated[Path | None, typer.Option(help="PDF file to write.")] = None,
    svg: Annotated[Path | None, typer.Option(help="SVG file to write; one page.")] = None,
    paper: Annotated[
        Paper, typer.Option(case_sensitive=False, help="fit: one page as large as needed.")
    ] = Paper.FIT,
    tiles: Annotated[
        bool, typer.Option("--tiles", help="Several pages to glue, if one is too small (PDF).")
    ] = False,
    margin_mm: Annotated[
        float, typer.Option(help="Edge that the printer leaves blank; 3 to 5 mm for most.")
    ] = 5.0,
) -> None:
    """Draw a target at true scale, in vectors, with its name, its sizes and a ruler to check it.

    Print at 100 % on matte paper, lay a ruler on the printed one, cut along the outline, hang it
    flat with the arrow up.

    Example: python -m detector_training target print bullseye-200 --pdf target.pdf --paper A4
    """
    _check_names(pdf, svg, tiles)
    shape, digest = load_round_target(name), _digest(name)
    pages = lay_out(shape, digest, paper, margin_mm, tiles)
    title = f"{printable(shape.name)} {digest}"
    if svg is not None and len(pages) > 1:
        raise TargetPrintError(f"--svg {svg} is one page, not {len(pages)}; use --pdf for tiles")
    files: list[tuple[Path, bytes]] = []
    if pdf is not None:
        files.append((pdf, pdf_bytes(pages, title)))
    if svg is not None:
        files.append((svg, svg_text(pages[0], title).encode()))
    size = f"{pages[0].width_mm:g} x {pages[0].height_mm:g} mm"
    for path, content in files:
        write_file(path, content)
        count = "1 page" if len(pages) == 1 else f"{len(pages)} pages"
        console.print(
            f"{path}: {count} of {size}; print at 100 %, then check "
            "the ruler: 1 mm off in 100 mm is 1 % off in every distance",
            soft_wrap=True,
            markup=False,
            highlight=False,
        )


def _check_names(pdf: Path | None, svg: Path | None, tiles: bool) -> None:
    if pdf is None and svg is None:
        raise TargetPrintError("nothing to write: name a file with --pdf or --svg")
    for option, path in (("pdf", pdf), ("svg", svg)):
        if path is not None and path.suffix.lower() != f".{option}":
            raise TargetPrintError(f"--{option} {path}: name a .{option} file")


def _digest(name: str) -> str:
    path = target_file(name)
    try:
        return digest_of(path.read_bytes())
    except OSError as error:
        raise TargetFileError(f"target file {path}: {error.strerror}") from None


def _as_json(name: str, shape: Target) -> dict[str, Any]:
    return {
        "name": shape.name,
        "file": str(target_file(name)),
        "hash": _digest(name),
        "board": {"side_m": shape.board_side_m, "shade": shape.board_shade},
        "discs": [{"diameter_m": d.diameter_m, "shade": d.shade} for d in shape.discs],
        "levels": {level.value: side_m for level, side_m in shape.level_m.items()},
        "points": [{"name": p.name, "y_m": p.y_m, "z_m": p.z_m} for p in shape.points],
        "colours": {shade.value: colour for shade, colour in shape.colours.items()},
    }
