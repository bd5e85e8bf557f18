"""``drone-client record``: a camera's pictures, to calibrate from or to replay."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from drone_client.errors import SourceError
from drone_client.source.choose import REALSENSE, open_live
from drone_client.source.realsense_setup import RealsenseSettings
from drone_client.source.record import record as run_record
from rgbd_wire.clock import MonotonicClock


def record(
    out: Annotated[Path, typer.Argument(help="folder to be made: TUM RGB-D layout, camera.json")],
    source: Annotated[
        str,
        typer.Option(
            help="realsense, realsense:SERIAL where there are several, or realsense:FILE, a .bag "
            "or .db3 of the RealSense SDK"
        ),
    ] = REALSENSE,
    camera: Annotated[
        Path | None,
        typer.Option(help="camera JSON, in place of what the camera says", show_default=False),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=0.1, max=86_400, help="stop after this; without it at Ctrl-C"),
    ] = None,
    size: Annotated[str, typer.Option(help="of the colour pictures [px]")] = "640x480",
    depth_size: Annotated[str, typer.Option(help="of the depth pictures [px]")] = "640x480",
    rate_hz: Annotated[int, typer.Option(min=1, max=300, help="pictures a second")] = 30,
    emitter: Annotated[
        bool, typer.Option("--emitter/--no-emitter", help="the infrared pattern")
    ] = True,
    laser_power_mw: Annotated[
        float | None, typer.Option(min=0, help="of the pattern; without it as the camera has it")
    ] = None,
    preset: Annotated[
        str | None, typer.Option(help='of the depth sensor by its name, such as "High Accuracy"')
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the outcome as JSON")] = False,
) -> None:
    """Record a camera into a folder, as drone-client replay and calibrate read it.

    Depth is raw, neither aligned nor filtered; stamps are the camera's, on this machine's clock.
    camera.json is written from what the camera says of itself. An interrupt ends the recording,
    and what was recorded is kept.

    Example: drone-client record REC --seconds 60
    """
    settings = RealsenseSettings(
        color_size_px=_size("--size", size),
        depth_size_px=_size("--depth-size", depth_size),
        rate_hz=rate_hz,
        emitter=emitter,
        laser_power_mw=laser_power_mw,
        preset=preset,
    )
    live = open_live(source, MonotonicClock(), settings, camera)
    errors = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=errors, disable=not errors.is_terminal) as progress:
        task = progress.add_task("waiting for the camera", total=seconds)

        def on_progress(so_far_s: float, frames: int) -> None:
            progress.update(task, completed=so_far_s, description=f"{frames} frames")

        recorded = run_record(live, out, seconds, on_progress)
    if as_json:
        print(json.dumps({**asdict(recorded), "folder": str(recorded.folder)}, indent=2))
        return
    say = Console(soft_wrap=True)
    say.print(
        f"{recorded.folder}: {recorded.frames} frames in {recorded.seconds:.1f} s, "
        f"{recorded.with_depth} with depth, {recorded.left_out} left out",
        markup=False,
        highlight=False,
    )
    counts = ", ".join(f"{name} {number}" for name, number in recorded.camera_counts.items())
    say.print(f"camera: {counts}", markup=False, highlight=False)
    if recorded.ended_by not in ("time", "interrupt"):
        raise SourceError(f"{recorded.ended_by}; what came before is in {recorded.folder}")


def _size(option: str, text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if match is None:
        raise SourceError(f"{option} {text[:40]!r} is no size; such as 640x480")
    return int(match.group(1)), int(match.group(2))
