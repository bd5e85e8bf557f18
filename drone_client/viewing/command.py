"""``drone-client log``: a run's folder for the viewers that people know."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from drone_client.errors import OutputError
from drone_client.viewing.facts import FlightFacts
from drone_client.viewing.live import Address, check_free, parse_address
from drone_client.viewing.run_folder import RunFolder
from drone_client.viewing.viewer import FileViewer, need

POLL_S: Final = 0.05
EXIT_INTERRUPTED: Final = 130


class GivenUpError(OutputError):
    """Somebody did not want to wait for a file."""


def log(
    run: Annotated[Path, typer.Argument(help="folder of a flight or a replay")],
    mcap: Annotated[
        Path | None,
        typer.Option(help="MCAP file to write, in Foxglove's schemas", show_default=False),
    ] = None,
    rerun: Annotated[
        Path | None, typer.Option(help="Rerun recording (.rrd) to write", show_default=False)
    ] = None,
    foxglove: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="serve it live to Foxglove, until Ctrl-C: for a run that is under way",
            show_default=False,
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="files of these names may go")
    ] = False,
) -> None:
    """Write a run for Foxglove (or any reader of MCAP) and for Rerun, or serve it live.

    All is taken from the run's folder; of a replay and of flights before poses and pictures were
    recorded there is less to see. Times are the drone's monotonic clock.

    Example: drone-client log runs/tunnel --mcap tunnel.mcap --rerun tunnel.rrd

    Example: drone-client log RUN --foxglove 8765
    """
    console = Console(stderr=True)
    if mcap is None and rerun is None and foxglove is None:
        raise OutputError("nothing to write: give --mcap, --rerun or --foxglove")
    address = None if foxglove is None else parse_address(foxglove)
    check_views(mcap, rerun, address, overwrite=overwrite)
    for path, write in ((mcap, write_mcap), (rerun, write_rerun)):
        if path is not None:
            try:
                write(run, path, overwrite=overwrite, console=console)
            except GivenUpError as error:
                console.print(str(error), style="yellow", markup=False, soft_wrap=True)
                raise typer.Exit(EXIT_INTERRUPTED) from None
            console.print(f"wrote {path}", markup=False, highlight=False, soft_wrap=True)
    if address is not None:
        serve(run, address, console, threading.Event())


def check_views(
    mcap: Path | None, rerun: Path | None, address: Address | None = None, *, overwrite: bool
) -> None:
    """See early whether the views of a run could be written.

    Raises:
        OutputError: a package is missing, a file is there already or its folder is not, or the
            address is taken.
    """
    if mcap is not None or address is not None:
        need("foxglove", "--foxglove" if mcap is None else "--mcap")
    if rerun is not None:
        need("rerun", "--rerun")
    for option, path in (("--mcap", mcap), ("--rerun", rerun)):
        if path is not None:
            check_file(option, path, overwrite=overwrite)
    if address is not None:
        check_free(address)


def check_file(option: str, path: Path, *, overwrite: bool) -> None:
    """See early whether a file could be written.

    Raises:
        OutputError: it is there already and may not go, or its folder is not there.
    """
    try:
        is_folder, is_there = path.is_dir(), path.exists()
        has_folder = path.absolute().parent.is_dir()
    except OSError as error:  # it may not be looked at, or no file has so long a name
        raise OutputError(f"{option} {path}: {error.strerror}") from None
    if is_folder:
        raise OutputError(f"{option} {path} is a folder: give the name of a file")
    if is_there and not overwrite:
        raise OutputError(f"{option} {path} is there already: another name, or --overwrite")
    if not has_folder:
        raise OutputError(f"{option} {path}: there is no folder {path.parent}")


def write_mcap(run: Path, path: Path, *, overwrite: bool, console: Console) -> None:
    """Write a run that has ended as MCAP, with a progress bar.

    Raises:
        OutputError: no run is there, the package is missing, the file cannot be written, or
            somebody gave it up.
    """
    check_views(path, None, overwrite=overwrite)
    from drone_client.viewing.foxglove import McapFile  # an extra

    _write(run, lambda facts: McapFile(path, facts, overwrite=overwrite), "--mcap", path, console)


def write_rerun(run: Path, path: Path, *, overwrite: bool, console: Console) -> None:
    """Write a run that has ended for Rerun, with a progress bar.

    Raises:
        OutputError: no run is there, the package is missing, the file cannot be written, or
            somebody gave it up.
    """
    check_views(None, path, overwrite=overwrite)
    from drone_client.viewing.rerun_file import RerunFile  # an extra, slow to load

    _write(run, lambda facts: RerunFile(path, facts, overwrite=overwrite), "--rerun", path, console)


def _write(
    run: Path,
    opener: Callable[[FlightFacts | None], FileViewer],
    option: str,
    path: Path,
    console: Console,
) -> None:
    folder = RunFolder(run)
    viewer = opener(folder.facts())
    try:
        with progress_bar(console) as progress:
            for moment in progress.track(folder.grown(), description=f"writing {path.name}"):
                viewer.show(moment)
        viewer.close()
    except KeyboardInterrupt:
        viewer.discard()
        raise GivenUpError(
            f"{path} was given up; this writes it: drone-client log {run} {option} {path}"
        ) from None
    except BaseException:
        viewer.discard()
        raise
    if folder.unread:
        console.print(f"{folder.unread} lines could not be read, and are left out", style="yellow")


def serve(run: Path, address: Address, console: Console, over: threading.Event) -> None:
    """Serve a run live, from its first moment on, until it is over.

    Raises:
        OutputError: no run is there, the package is missing, or the address is taken.
    """
    need("foxglove", "--foxglove")
    from drone_client.viewing.foxglove import LiveServer  # an extra

    folder = RunFolder(run)
    server = LiveServer(address.host, address.port, folder.facts())
    console.print(
        f"serving {run} at ws://{address.host}:{server.port}: in Foxglove, Open connection",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    try:
        while not over.wait(POLL_S):
            for moment in folder.grown():
                server.show(moment)
    finally:
        server.close()


def progress_bar(console: Console) -> Progress:
    """A bar for files that take their time; silent where nobody looks."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        console=console,
        disable=not console.is_terminal,
    )
