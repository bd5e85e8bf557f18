"""``drone-client calibrate``: does the camera file fit the cameras?"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from drone_client.calibration.candidates import FromRun, FromTruth, FromWorker, WhereIsIt
from drone_client.calibration.report import (
    Calibration,
    as_json,
    check_plot_path,
    plot_calibration,
    print_table,
)
from drone_client.calibration.sighting import Miss, Sighting, sight
from drone_client.calibration.verdicts import Finding, judge
from drone_client.errors import ClientError, SourceError
from drone_client.source import Recording, stride
from drone_client.source.choose import open_recorded
from drone_client.truth import load_truth
from target_pose.errors import TargetError
from target_pose.target import DEFAULT_TARGET, Target, load_round_target

EXIT_CODES = {Finding.GOOD: 0, Finding.OFF: 1, Finding.UNKNOWN: 2}


def calibrate(
    recording: Annotated[
        str, typer.Argument(help="folder in TUM RGB-D layout, ROS 2 bag, .mcap or ROS 1 .bag")
    ],
    camera: Annotated[
        Path | None,
        typer.Option(
            help="camera JSON to be checked; without it FOLDER/camera.json", show_default=False
        ),
    ] = None,
    target: Annotated[
        str, typer.Option(help="name of a packaged target or path of a target TOML")
    ] = DEFAULT_TARGET,
    worker: Annotated[
        str | None, typer.Option(help="HTTP address of an edge service that finds the target")
    ] = None,
    run: Annotated[
        Path | None, typer.Option(help="folder of an earlier replay of it that found the target")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="JSON with the true poses: only tells where to look")
    ] = None,
    frames: Annotated[
        int, typer.Option(min=1, max=100_000, help="look at so many at most, spread evenly")
    ] = 100,
    timeout_s: Annotated[
        float, typer.Option(min=0.1, max=600, help="give a worker so long per frame")
    ] = 10.0,
    plot: Annotated[
        Path | None, typer.Option(help="PNG with both opinions over range and tilt")
    ] = None,
    as_json_: Annotated[bool, typer.Option("--json", help="print everything as JSON")] = False,
) -> None:
    """Check the camera file: do circles in colour and the plane in depth agree?

    In each frame the target is measured twice, by its printed circles in the colour picture and by
    the board's plane in the raw depth. From many ranges and tilts the differences tell apart what
    is wrong: depth_scale_m (or the print's size, or the focal length), the shift and the turn of
    color_from_depth. Where the target is, one of --worker, --run and --truth says. Nothing is
    changed: what to set is printed.

    A good recording: from 0.7 m to 3 m, then from the left, the right, above and below, by 20 to
    45 degrees, slowly, target always whole in the picture; a minute is plenty.

    Exit code 0: what was seen is good; 1: something is off; 2: nothing could be said.

    Example: drone-client calibrate REC --worker http://127.0.0.1:8080 --plot rec.png
    """
    if plot is not None:
        check_plot_path(plot)
    try:
        printed = load_round_target(target)
    except TargetError as error:
        raise ClientError(str(error)) from None
    source = open_recorded(recording, camera)
    where = _where(source, printed, worker, run, truth, timeout_s)
    name = Path(recording).resolve().name
    found = look(source, where, printed, frames, _progress(escape(name)))
    if truth is not None and source.notes:
        # one picture that was left out, and each after it would have had its neighbour's pose
        raise SourceError(
            "not all of the recording could be read, and --truth knows its poses by their numbers: "
            + "; ".join(source.notes)
        )
    sightings = tuple(s for s in found if isinstance(s, Sighting))
    misses = tuple(m for m in found if isinstance(m, Miss))
    judgement = judge(sightings, source.camera, printed)
    outcome = Calibration(name, printed.name, sightings, misses, judgement)
    if plot is not None:
        plot_calibration(plot, outcome, source.camera.color_from_depth)
    if as_json_:
        print(json.dumps(as_json(outcome), indent=2))
    else:
        print_table(outcome, Console())
    raise typer.Exit(EXIT_CODES[judgement.finding])


def look(
    source: Recording,
    where: WhereIsIt,
    target: Target,
    at_most: int,
    progress: Progress | None = None,
    on_frame: Callable[[int], None] = lambda done: None,
) -> list[Sighting | Miss]:
    """What each of some frames of a recording says."""
    step = stride(len(source), at_most)
    total = len(range(0, len(source), step))
    found: list[Sighting | Miss] = []
    bar = Progress(disable=True) if progress is None else progress
    with bar:
        task = bar.add_task("frames", total=total, counts="")
        for n, capture in enumerate(source.some_captures(at_most)):
            candidate = where(n * step, capture)
            if isinstance(candidate, str):
                found.append(Miss(capture.name, candidate))
            else:
                found.append(
                    sight(
                        capture.name,
                        capture.color_rgb,
                        capture.depth_units,
                        source.camera,
                        candidate,
                        target,
                    )
                )
            used = sum(isinstance(f, Sighting) for f in found)
            bar.update(task, completed=n + 1, counts=f"{used} with the target")
            on_frame(n + 1)
    return found


def _where(
    source: Recording,
    target: Target,
    worker: str | None,
    run: Path | None,
    truth: Path | None,
    timeout_s: float,
) -> WhereIsIt:
    if sum(given is not None for given in (worker, run, truth)) != 1:
        raise ClientError(
            "where the target is, exactly one of these says: --worker http://127.0.0.1:8080 (a "
            "running edge-service serve), --run FOLDER (of an earlier drone-client replay), "
            "--truth FILE"
        )
    if worker is not None:
        asked = FromWorker(worker, source.camera, target, timeout_s)
        asked.check()
        return asked
    if run is not None:
        return FromRun(run)
    assert truth is not None
    return FromTruth(load_truth(truth, len(source)), source.camera, target)


def _progress(title: str) -> Progress:
    errors = Console(stderr=True)
    return Progress(
        TextColumn(title),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[counts]}"),
        TimeElapsedColumn(),
        console=errors,
        disable=not errors.is_terminal,
    )
