"""``scripts/figures``: the command line."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from contact_sim.errors import SimulatorError
from contact_sim.figures.bench import LINK, FigureBench
from contact_sim.figures.catalogue import CATALOGUE, FigureEntry, chosen
from contact_sim.figures.page import write_page
from contact_sim.figures.style import check_writable, save
from contact_sim.sensing.gl import choose_gl
from rgbd_wire.errors import WireError

EXIT_INCOMPLETE: Final = 3
OUT: Final = Path("runs/figures")
FLIGHTS: Final = 100


def figures(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME]...",
            help=f"which (default: all): {', '.join(entry.name for entry in CATALOGUE)}",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="folder for the PNG files")] = OUT,
    page: Annotated[
        Path | None,
        typer.Option(
            help="also write this Markdown page with all figures in the folder", show_default=False
        ),
    ] = None,
    service: Annotated[
        bool,
        typer.Option(
            "--service",
            help="runs 1 and 2 through a real service too, with drawn pictures: minutes each",
        ),
    ] = False,
    connect: Annotated[
        str | None,
        typer.Option(
            help="Zenoh endpoint of a service that runs (default: one is started where a figure "
            "needs it)",
            show_default=False,
        ),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(
            help="flights.csv of 'python -m contact_sim campaign': its flights without faults are "
            "those of contact-map and contact-force",
            show_default=False,
        ),
    ] = None,
    flights: Annotated[
        int, typer.Option(min=1, max=10_000, help="in each world, where there is no --table")
    ] = FLIGHTS,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="processes for them")] = 2,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="few flights and pictures: a test that everything works"),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="print what became of each figure as JSON")
    ] = False,
) -> None:
    """Draw the paper's figures, and some beyond it, from flights of the real client.

    Flights are flown in lockstep with the simulator: the same seed gives the same flight.
    Figures fly-by, conditions and film look at drawn pictures with a real service. Each PNG carries
    its caption and its command; --page puts them on a page.

    Exit code 0: all were drawn. 3: some could not be; it says why, and the others are there.

    Example: scripts/figures cbf-boundary barrier

    The committed page: scripts/figures --service --out docs/results/figures --page
    docs/results/figures.md
    """
    entries = chosen(names or [])
    for path in (*(out / f"{entry.name}.png" for entry in entries), *([page] if page else [])):
        check_writable(path)
    asked = Asked(service, table, flights, quick)
    console = Console(stderr=True)
    failed: dict[str, str] = {}
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
    )
    draws = service or any(entry.drawn for entry in entries)
    if draws:
        choose_gl()
    with ExitStack() as stack:
        stack.enter_context(bar)
        whole = bar.add_task("figures", total=len(entries))
        part = bar.add_task("", total=1, visible=False)

        def tell(what: str, done: int, of: int) -> None:
            bar.update(part, description=f"  {what}", completed=done, total=of, visible=done < of)

        bench = stack.enter_context(
            FigureBench(
                quick=quick,
                pictures=service,
                connect=connect,
                table=table,
                flights=flights,
                jobs=jobs,
                tell=tell,
            )
        )
        if draws and connect is not None:
            _ = bench.service  # nobody there: told before anything is flown
        for entry in entries:
            bar.update(whole, description=entry.name)
            if (why := _draw(entry, bench, out, asked.command(entry))) is not None:
                failed[entry.name] = why
                bar.console.print(f"{entry.name}: {why}", style="red", markup=False)
            bar.update(part, visible=False)
            bar.advance(whole)
        bar.update(whole, description="figures")
    if page is not None:
        write_page(page, out)
    _report(entries, failed, out, as_json=as_json)
    if failed:
        raise typer.Exit(EXIT_INCOMPLETE)


class Asked(NamedTuple):
    """The options that change what is drawn."""

    service: bool
    table: Path | None
    flights: int
    quick: bool

    def command(self, entry: FigureEntry) -> str:
        """What draws one figure again."""
        words = ["scripts/figures", entry.name]
        if self.service and entry.of_runs:
            words.append("--service")
        if entry.of_many and self.table is not None:
            words.append(f"--table {self.table}")
        elif entry.of_many and self.flights != FLIGHTS:
            words.append(f"--flights {self.flights}")
        if self.quick:
            words.append("--quick")
        return " ".join(words)


def _draw(entry: FigureEntry, bench: FigureBench, folder: Path, command: str) -> str | None:
    """Draw one; why not, or None."""
    try:
        figure, caption = entry.draw(bench)
        save(figure, folder / f"{entry.name}.png", caption, command)
    except (SimulatorError, WireError) as error:
        return " ".join(str(error).split())
    return None


def _report(
    entries: tuple[FigureEntry, ...], failed: dict[str, str], out: Path, *, as_json: bool
) -> None:
    drawn = [entry.name for entry in entries if entry.name not in failed]
    if as_json:
        paths = {name: str(out / f"{name}.png") for name in drawn}
        print(json.dumps({"link": LINK, "drawn": paths, "failed": failed}, indent=2))
        return
    for name in drawn:
        print(out / f"{name}.png")
