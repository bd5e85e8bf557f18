"""What people get to look at of a flight: which files they asked for, and their writing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from drone_client.errors import ClientError, WorldError
from drone_client.fly.simulator import Simulator
from drone_client.run_report import write_summary
from drone_client.viewing.command import (
    check_file,
    check_views,
    progress_bar,
    write_mcap,
    write_rerun,
)
from drone_client.viewing.live import Address, parse_address
from drone_client.viewing.recorder import FlightRecorder

FILMS: Final = (".mp4", ".webm")


@dataclass(frozen=True, slots=True)
class Views:
    """What was asked for."""

    video: Path | None = None
    mcap: Path | None = None
    rerun: Path | None = None
    live: Address | None = None

    @property
    def wants_pictures(self) -> bool:
        """Whether any of them shows the camera's pictures."""
        return any(v is not None for v in (self.video, self.mcap, self.rerun, self.live))


def checked(
    video: Path | None,
    mcap: Path | None,
    rerun: Path | None,
    foxglove: str | None,
    *,
    simulated: bool,
    overwrite: bool,
) -> Views:
    """What was asked for, looked at before the flight: whether it can be had.

    Raises:
        ClientError: something cannot.
    """
    live = None if foxglove is None else parse_address(foxglove)
    if video is not None:
        if not simulated:
            raise WorldError(
                "--video shows a simulated world, with --sim; of a real flight take --mcap or "
                "--rerun"
            )
        if video.suffix not in FILMS:
            raise WorldError(f"--video {video}: a film is called {' or '.join(FILMS)}")
        check_file("--video", video, overwrite=overwrite)
    check_views(mcap, rerun, live, overwrite=overwrite)
    return Views(video, mcap, rerun, live)


def told(recorder: FlightRecorder, world: Simulator | None) -> dict[str, Any]:
    """What stands in the summary about recording and world."""
    about = {"recording": recorder.report()}
    return about if world is None else about | {"simulated": world.report()}


def write_views(
    views: Views,
    folder: Path,
    summary: dict[str, Any],
    world: Simulator | None,
    console: Console,
    *,
    overwrite: bool,
) -> None:
    """Write them from a run that has ended; what cannot be is told in the summary, and no error.

    Args:
        views: which.
        folder: of the run.
        summary: of the run; gets ``files``, and is written again.
        world: that it was flown in; None: ours.
        console: for progress and what was written.
        overwrite: files of these names may go.
    """
    jobs: list[tuple[Path, Callable[[], None]]] = []
    if (mcap := views.mcap) is not None:
        jobs.append((mcap, lambda: write_mcap(folder, mcap, overwrite=overwrite, console=console)))
    if (rerun := views.rerun) is not None:
        jobs.append(
            (rerun, lambda: write_rerun(folder, rerun, overwrite=overwrite, console=console))
        )
    if (video := views.video) is not None and world is not None:
        jobs.append((video, lambda: _film(world, folder, video, console)))
    summary["unwritten"] += summary["recording"]["unwritten"]
    if (problem := (summary.get("simulated") or {}).get("unwritten")) is not None:
        summary["unwritten"].append(problem)
    files: list[str] = []
    for path, job in jobs:
        try:
            job()
        except ClientError as error:
            summary["unwritten"].append(str(error))
            console.print(f"{error}", style="yellow", markup=False, soft_wrap=True)
            continue
        files.append(str(path))
        console.print(f"wrote {path}", markup=False, highlight=False, soft_wrap=True)
    summary["files"] = files
    write_summary(folder, summary)


def _film(world: Simulator, folder: Path, path: Path, console: Console) -> None:
    with progress_bar(console) as progress:
        task = progress.add_task(f"filming {path.name}", total=1.0)
        world.film(folder, path, lambda share: progress.update(task, completed=share))
