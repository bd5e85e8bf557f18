"""``dataset``: check, describe, convert and split labelled pictures."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn
from rich.table import Table

from detector_training.commands.shell import command_line, console
from detector_training.datasets import card as cards
from detector_training.datasets.check import Kind
from detector_training.datasets.convert import WRITERS, Written
from detector_training.datasets.files import inside
from detector_training.datasets.inspection import Report, inspect_dataset
from detector_training.datasets.load import Format, load_dataset, recognise
from detector_training.datasets.names import LabelNames
from detector_training.datasets.output import new_folder, write_file
from detector_training.datasets.sheet import draw_sheet, write_png
from detector_training.datasets.split import Split, group_alike, looks_of, split_groups
from detector_training.datasets.stats import Spread, Stats, dataset_stats
from detector_training.datasets.stats_plot import formats, plot_stats
from detector_training.errors import DatasetError
from target_pose.target import DEFAULT_TARGET, load_round_target

MOST_LINES = 200
"""Findings printed for people; --json gives all."""

Data = Annotated[
    Path,
    typer.Argument(
        help="Data set: a folder with labels.jsonl, labelme JSON, YOLO's data.yaml or a COCO .json "
        "(recognised by itself), or the path of such a file."
    ),
]
Maps = Annotated[
    list[str] | None,
    typer.Option("--map", help="NAME=LEVEL: what another name means; repeatable."),
]
Ignores = Annotated[
    list[str] | None,
    typer.Option("--ignore", help="Name of labels to leave out; repeatable."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]

dataset = typer.Typer(
    help="Check, describe, convert and split labelled pictures: labelme, YOLO, COCO, labels.jsonl.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def register(app: typer.Typer) -> None:
    """Add ``dataset`` to a command line."""
    app.add_typer(dataset, name="dataset")


@dataset.command()
def check(
    data: Data,
    against: Annotated[
        Path | None,
        typer.Option(help="Another data set, as training against test: no picture in both."),
    ] = None,
    target: Annotated[
        str, typer.Option(help="Target that the pictures show, or the path of your own .toml.")
    ] = DEFAULT_TARGET,
    maps: Maps = None,
    ignores: Ignores = None,
    flags: Annotated[
        list[str] | None,
        typer.Option("--flag", help="A condition of your own that is no slip; repeatable."),
    ] = None,
    sheet: Annotated[
        Path | None, typer.Option(help="Draw the worst pictures into this PNG.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find wrong labels and pictures, and say which file each is in; status 1 if any is wrong.

    Looks for levels that do not nest, boxes outside of the picture, double and tiny ones, pictures
    that are missing, damaged, of another size, without a label or there twice, and unknown flags.

    Example: python -m detector_training dataset check my-pictures --sheet wrong.png
    """
    if sheet is not None and sheet.suffix.lower() != ".png":
        raise DatasetError(f"--sheet {sheet}: name a .png file")
    shape = load_round_target(target)
    names = LabelNames.parse(maps or (), ignores or ())
    with _bar("pictures") as bar:
        report = inspect_dataset(data, shape, names, flags or (), against, bar)
    if sheet is not None:
        drawn = draw_sheet(report.samples, report.findings)
        if drawn is not None:
            write_png(sheet, drawn)
        note = f"look at {sheet}" if drawn is not None else f"nothing to draw, no {sheet} written"
        console.print(note, soft_wrap=True, markup=False)
    if as_json:
        typer.echo(json.dumps(report.as_json(), indent=1))
    else:
        _print_findings(report)
    raise typer.Exit(1 if report.wrong else 0)


@dataset.command()
def stats(
    data: Data,
    plot: Annotated[
        Path | None, typer.Option(help="Draw conditions, sizes and distances: .png, .pdf or .svg.")
    ] = None,
    maps: Maps = None,
    ignores: Ignores = None,
    as_json: AsJson = False,
) -> None:
    """Count pictures, boxes, sizes, distances and the paper's eight conditions.

    Example: python -m detector_training dataset stats runs/train --plot conditions.png
    """
    if plot is not None and plot.suffix.lower() not in formats():
        raise DatasetError(f"--plot {plot}: the name must end in {', '.join(formats())}")
    samples = load_dataset(data, LabelNames.parse(maps or (), ignores or ()))
    numbers = dataset_stats(samples)
    if plot is not None:
        plot_stats(numbers, samples, plot)
        console.print(f"look at {plot}", soft_wrap=True, markup=False)
    if as_json:
        typer.echo(json.dumps(numbers.as_json(), indent=1))
    else:
        _print_stats(numbers)


@dataset.command()
def card(
    data: Data,
    out: Annotated[
        Path | None, typer.Option(help=f"File to write; {cards.CARD} in the data set by default.")
    ] = None,
    maps: Maps = None,
    ignores: Ignores = None,
) -> None:
    """Write a data set card: what, how many, conditions, splits, licences, hashes (Markdown).

    Example: python -m detector_training dataset card runs/train
    """
    found = recognise(data)
    path = out or found.folder / cards.CARD
    samples = load_dataset(data, LabelNames.parse(maps or (), ignores or ()))
    description = cards.read_description(found.folder)
    with _bar("pictures") as bar:
        hashes = cards.hash_dataset(samples, lambda done: bar(done, len(samples)))
    write_file(path, cards.card_text(found, dataset_stats(samples), hashes, description))
    console.print(f"card: {path}", soft_wrap=True, markup=False)


@dataset.command()
def convert(
    data: Data,
    out: Annotated[Path, typer.Argument(help="New folder.")],
    to: Annotated[Format, typer.Option(help="Format to write; lines is our labels.jsonl.")],
    maps: Maps = None,
    ignores: Ignores = None,
) -> None:
    """Write a data set in another format, with the pictures copied.

    YOLO holds neither boxes over the border (they are clipped) nor conditions and distances; the
    others hold everything.

    Example: python -m detector_training dataset convert runs/train to-correct --to labelme
    """
    samples = load_dataset(data, LabelNames.parse(maps or (), ignores or ()))
    description = _handed_on(data, out)
    with _bar("pictures") as bar:
        written = WRITERS[to](samples, out, lambda done: bar(done, len(samples)))
    write_file(out / cards.DESCRIPTION, description)
    console.print(f"{out}: {_told(written)}", soft_wrap=True, markup=False)


@dataset.command()
def split(
    data: Data,
    out: Annotated[
        Path, typer.Argument(help="New folder; gets train/ and val/, for YOLO in images/.")
    ],
    val: Annotated[float, typer.Option(help="Share of the pictures to hold out.")] = 0.2,
    seed: Annotated[int, typer.Option(help="The same seed holds the same pictures out.")] = 0,
    to: Annotated[Format, typer.Option(help="Format to write.")] = Format.LINES,
    by_folder: Annotated[
        bool, typer.Option("--by-folder", help="Keep all pictures of a folder on one side.")
    ] = False,
    maps: Maps = None,
    ignores: Ignores = None,
) -> None:
    """Hold pictures out for validation; frames of one recording stay together.

    Pictures that look alike, or follow each other in a folder with much in common, never end up on
    both sides.

    Example: python -m detector_training dataset split my-pictures data --val 0.2 --seed 1
    """
    samples = load_dataset(data, LabelNames.parse(maps or (), ignores or ()))
    description = _handed_on(data, out)
    with _bar("pictures looked at") as bar:
        looks = looks_of(samples, lambda done: bar(done, len(samples)))
    halves = split_groups(samples, group_alike(samples, looks, by_folder), val, seed)
    if halves.cut:
        console.print(
            f"nearly all pictures look like one recording: its last {len(halves.val)} are held "
            "out, which flatters the score; better take pictures at a second place",
            style="yellow",
            soft_wrap=True,
            markup=False,
        )
    places = _write_halves(halves, out, to)
    for place in (out,) if to is Format.YOLO else places:
        write_file(place / cards.DESCRIPTION, description)
    console.print(
        f"{len(halves.train)} pictures in {places[0]}, {len(halves.val)} in {places[1]}, "
        f"{halves.groups} groups of pictures that belong together",
        soft_wrap=True,
        markup=False,
    )


def _handed_on(data: Path, out: Path) -> str:
    """The description of what is made from a data set; refuses to make it inside of that."""
    folder = recognise(data).folder
    if inside(folder, out) and out.absolute() != folder.absolute():
        raise DatasetError(f"{out} lies in the data set itself; name a folder beside {folder}")
    return cards.handed_on(cards.read_description(folder), data, command_line())


def _write_halves(halves: Split, out: Path, to: Format) -> tuple[Path, Path]:
    """Write both sides; returns their folders."""
    total, past = len(halves.train) + len(halves.val), len(halves.train)
    with _bar("pictures copied") as bar:
        if to is Format.YOLO:  # holds both sides in one data set
            WRITERS[to]((*halves.train, *halves.val), out, lambda n: bar(n, total))
            return out / "images" / "train", out / "images" / "val"
        with new_folder(out) as folder:
            WRITERS[to](halves.train, folder / "train", lambda n: bar(n, total))
            WRITERS[to](halves.val, folder / "val", lambda n: bar(past + n, total))
    return out / "train", out / "val"


@contextmanager
def _bar(what: str) -> Iterator[Callable[[int, int], None]]:
    columns = (BarColumn(), MofNCompleteColumn(), what, TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _print_findings(report: Report) -> None:
    for finding in report.findings[:MOST_LINES]:
        place = f"{finding.file}: " if finding.file else ""
        typer.echo(f"{'wrong' if finding.wrong else 'note '}  {place}{finding.text}")
    if (more := len(report.findings) - MOST_LINES) > 0:
        typer.echo(f"... and {more} more; --json lists all")
    if any(f.kind is Kind.NESTING for f in report.findings):
        typer.echo("boxes go around whole shapes, also where something hides a part of them")
    kinds = Counter(str(f.kind) for f in report.findings if f.wrong)
    told = ", ".join(f"{n} {kind}" for kind, n in kinds.most_common()) or "nothing wrong"
    notes = len(report.findings) - report.wrong
    typer.echo(
        f"{report.path} ({report.format}): {len(report.samples)} labelled pictures, {told}"
        f"{f'; {notes} notes' if notes else ''}"
    )


def _print_stats(numbers: Stats) -> None:
    typer.echo(
        f"{numbers.pictures} pictures, {numbers.with_target} with a target, "
        f"{numbers.negatives} without; {numbers.cut} boxes of which under 90 % is to be seen"
    )
    out = Console()  # the shared one is for what is no result
    counts = Table("condition", "pictures", title="The paper's conditions, pictures with a target")
    for name, number in numbers.conditions.items():
        counts.add_row(name, str(number))
    sizes = Table("what", "number", "least", "10 %", "median", "90 %", "most", title="Spread")
    for level, values in numbers.box_side_px.items():
        sizes.add_row(escape(f"{level} [px]"), *_cells(values))
    sizes.add_row(escape("distance [m]"), *_cells(numbers.distance_m))
    out.print(counts, sizes)


def _cells(values: Spread | None) -> list[str]:
    if values is None:
        return ["0", *["-"] * 5]
    v = values
    return [str(v.count), *(f"{x:.3g}" for x in (v.least, v.p10, v.median, v.p90, v.most))]


def _told(written: Written) -> str:
    parts = [f"{written.pictures} pictures, {written.boxes} boxes"]
    if written.clipped:
        parts.append(f"{written.clipped} boxes clipped at the border")
    if written.dropped:
        parts.append(f"{written.dropped} boxes outside of their picture left out")
    if written.turned:
        parts.append(f"{written.turned} pictures are turned by EXIF, labels count in them as shown")
    if written.lost:
        parts.append(f"this format has no place for {', '.join(written.lost)}")
    return "; ".join(parts)
