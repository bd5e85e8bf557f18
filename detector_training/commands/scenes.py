"""``scenes`` and ``recording``: the commands around the generator."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from detector_training.backgrounds import Split, advice, find_backgrounds, of_split
from detector_training.commands.shell import command_line, console
from detector_training.scenes import DatasetRequest, write_dataset
from detector_training.scenes.depth import DepthSensor
from detector_training.scenes.recipe import Recipe
from detector_training.scenes.recording import FRAMES, RATE_HZ, write_recording
from target_pose.target import DEFAULT_TARGET, load_round_target

Out = Annotated[Path, typer.Argument(help="Folder to write to; made when missing.")]
Seed = Annotated[int, typer.Option(help="The same seed gives the same bytes.")]
Backgrounds = Annotated[
    list[Path] | None,
    typer.Option(help="Folder of your own photographs, with its sub-folders; repeatable."),
]
PackageRoot = Annotated[
    Path,
    typer.Option(
        help="Where Debian's photo packages lie: / when installed, or the folder into which you "
        "unpacked them without being root (apt-get download P; dpkg -x P*.deb FOLDER)."
    ),
]


def register(app: typer.Typer) -> None:
    """Add ``scenes`` and ``recording`` to a command line."""
    app.command("scenes")(scenes)
    app.command("recording")(recording)


def scenes(
    out: Out,
    count: Annotated[int, typer.Option(help="Number of pictures.")] = 6000,
    seed: Seed = 1,
    split: Annotated[
        Split, typer.Option(help="No two of them share a background picture.")
    ] = Split.TRAIN,
    recipe: Annotated[
        Recipe,
        typer.Option(help="What the pictures shall show; mixed: all of it, as training wants it."),
    ] = Recipe.MIXED,
    depth: Annotated[
        DepthSensor,
        typer.Option(help="d455: also depth/NNNNNN.png, noisy; a tenth of them show nothing."),
    ] = DepthSensor.NONE,
    backgrounds: Backgrounds = None,
    package_root: PackageRoot = Path("/"),
    target: Annotated[
        str, typer.Option(help="Packaged target, or the path of your own .toml.")
    ] = DEFAULT_TARGET,
    jobs: Annotated[int, typer.Option(help="Processes; one a core is right.")] = os.cpu_count()
    or 1,
    overwrite: Annotated[bool, typer.Option(help="Replace the data set in OUT.")] = False,
) -> None:
    """Render labelled 640x480 pictures of the target, and look-alikes without it.

    OUT gets images/NNNNNN.jpg, labels.jsonl (one JSON object a picture), dataset.json (seed,
    command, backgrounds) and contact_sheet.png, which is worth a look. With --depth d455 each label
    also says the camera and the true camera_from_target, and the pictures stay the same.

    Example: python -m detector_training scenes runs/train --count 6000 --seed 1 --split train
    """
    found = find_backgrounds(backgrounds or (), package_root)
    if line := advice(found):
        console.print(line, style="yellow", soft_wrap=True)
    load_round_target(target)
    request = DatasetRequest(count, seed, split, target, of_split(found, split), recipe, depth)
    columns = (BarColumn(), MofNCompleteColumn(), "pictures", TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("scenes", total=count)
        description = write_dataset(
            out,
            request,
            command_line(),
            jobs,
            overwrite,
            lambda done: progress.update(task, completed=done),
        )
    kinds = ", ".join(f"{n} {k}" for k, n in description["kinds"].items())
    console.print(f"{out}: {kinds}; look at {out / 'contact_sheet.png'}", soft_wrap=True)


def recording(
    out: Out,
    seed: Seed = 1,
    frames: Annotated[int, typer.Option(help="Number of frames, 12 a second.")] = FRAMES,
    target: Annotated[
        str, typer.Option(help="Packaged target, or the path of your own .toml.")
    ] = DEFAULT_TARGET,
    overwrite: Annotated[bool, typer.Option(help="Replace the recording in OUT.")] = False,
) -> None:
    """Render an approach flight in the TUM RGB-D layout, to replay without a camera.

    OUT gets rgb/, depth/, rgb.txt, depth.txt, groundtruth.txt, camera.json, truth.json (the true
    pose and boxes of each frame) and a README.md that says that it is rendered.

    Example: python -m detector_training recording examples/recordings/rendered-approach --seed 1
    """
    loaded = load_round_target(target)
    columns = (BarColumn(), MofNCompleteColumn(), "frames", TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("frames", total=frames)
        write_recording(
            out,
            seed,
            loaded,
            command_line(),
            frames,
            overwrite,
            lambda done: progress.update(task, completed=done),
        )
    console.print(f"{out}: {frames} frames, {RATE_HZ:g} Hz", soft_wrap=True)
