"""``python -m contact_sim film``: the film of a flight that is over, at any time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console

from contact_sim.errors import FilmError
from contact_sim.recording.encoder import CODECS
from contact_sim.recording.reel import load_reel
from contact_sim.recording.world import load_world
from contact_sim.sensing.gl import choose_gl
from drone_client.errors import ClientError
from drone_client.viewing.command import EXIT_INTERRUPTED, check_file, progress_bar

CUT_OFF_S: Final = 2.0
"""A record that ends so long before the flight is told."""


def film(
    run: Annotated[Path, typer.Argument(help="folder of a simulated flight", metavar="RUN_FOLDER")],
    out: Annotated[Path, typer.Argument(help="video to write: .mp4 or .webm", metavar="OUT")],
    board: Annotated[
        str | None,
        typer.Option(
            help="print in that world: clean, scratched or glossy (default: as it was flown)",
            show_default=False,
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="a file of this name may go")
    ] = False,
) -> None:
    """Draw the film of a simulated flight from the files in its folder.

    World, seed and board are the flight's own. The drone's own picture is in it if pictures were
    recorded: with --video, --mcap, --rerun or --foxglove of drone-client fly.

    A .webm takes one and a half times as long as the flight took, an .mp4 eight times.

    Example: python -m contact_sim film runs/a a.webm
    """
    console = Console(stderr=True)
    if out.suffix not in CODECS:
        raise FilmError(f"{out}: a film is called {' or '.join(CODECS)}")
    choose_gl()  # nothing is read where nothing could be drawn
    try:
        check_file("film", out, overwrite=overwrite)
        reel, unread = load_reel(run)
    except ClientError as error:
        raise FilmError(str(error)) from None
    world = load_world(run)
    if board is not None:
        world = world._replace(board=board)
    for sentence in (
        f"{unread} lines could not be read, and are left out" if unread else None,
        f"the record of how it truly was ends {reel.missing_s:.0f} s before the flight: so does "
        "the film"
        if reel.missing_s > CUT_OFF_S
        else None,
        None if reel.has_pictures else "no pictures were recorded: the drone's own stays empty",
        None if world.board else "no board was written down: a clean one is drawn",
    ):
        if sentence is not None:
            console.print(sentence, style="yellow", markup=False, soft_wrap=True)
    from contact_sim.recording.film import draw_film  # what it draws with is slow to load

    try:
        with progress_bar(console) as progress:
            task = progress.add_task(f"filming {out.name}", total=1.0)
            draw_film(
                reel, world.build(), out, lambda share: progress.update(task, completed=share)
            )
    except KeyboardInterrupt:
        sentence = f"{out} was given up: nothing of it is left"
        console.print(sentence, style="yellow", markup=False, soft_wrap=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    console.print(f"wrote {out}", markup=False, highlight=False, soft_wrap=True)
