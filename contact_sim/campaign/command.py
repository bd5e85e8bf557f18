"""``python -m contact_sim campaign``: the command line of many flights."""

from __future__ import annotations

import json
import os
from contextlib import ExitStack
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from contact_sim.campaign.faults import USUAL, Fault, Kind, load_faults
from contact_sim.campaign.report import by_group, page, summary
from contact_sim.campaign.row import Flight, FlightRow
from contact_sim.campaign.run import ABLATIONS, WHOLE, Table, fly_campaign, plan
from contact_sim.errors import CampaignError
from contact_sim.flight.service import ServiceProcess
from contact_sim.lockstep.service_eyes import ServiceEyes
from contact_sim.scene import BOARDS, WORLDS
from contact_sim.sensing.gl import choose_gl
from link_emulator.errors import EmulatorError
from link_emulator.profiles import PROFILES, profile

USUAL_FAULTS = "usual"
TABLE_NAME = "flights.csv"
PAGE_NAME = "flights.md"
_ELSEWHERE = frozenset({"out", "connect", "jobs", "resume", "overwrite", "write", "as_json"})
"""Options that do not change what is flown."""


class EyesName(StrEnum):
    """Who looks."""

    SERVICE = "service"
    MODEL = "model"


def campaign(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="folder for flights.csv and flights.md")] = Path(
        "runs/campaign"
    ),
    world: Annotated[
        list[str] | None, typer.Option(help="tunnel or refinery; again for both (default: both)")
    ] = None,
    flights: Annotated[int, typer.Option(min=1, max=100_000, help="of each kind")] = 20,
    first_seed: Annotated[int, typer.Option(min=0, help="seeds count from here")] = 0,
    board: Annotated[str, typer.Option(help="print: clean, scratched or glossy")] = "clean",
    link: Annotated[str, typer.Option(help=f"link: {', '.join(PROFILES)}")] = "wifi",
    eyes: Annotated[
        EyesName,
        typer.Option(
            help="service: pictures through a real service. model: a localiser's measured errors, "
            "without pictures, much faster"
        ),
    ] = EyesName.MODEL,
    connect: Annotated[
        str | None, typer.Option(help="Zenoh endpoint of a service that runs", show_default=False)
    ] = None,
    faults: Annotated[
        str | None,
        typer.Option(
            help="TOML with [[fault]] tables, or 'usual' for all kinds", show_default=False
        ),
    ] = None,
    ablations: Annotated[
        bool, typer.Option("--ablations", help="all of it also without each part of the contract")
    ] = False,
    plain: Annotated[
        bool, typer.Option("--plain/--no-plain", help="fly without faults, too")
    ] = True,
    jobs: Annotated[
        int | None, typer.Option(min=1, max=256, help="processes (default: one a core)")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="go on after the flights that are in the table")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="throw away the table that is there")
    ] = False,
    write: Annotated[
        Path | None, typer.Option(help="write the page here as well", show_default=False)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the summary as JSON")] = False,
) -> None:
    """Fly many times in lockstep, with other chances each time, and count what came of it.

    Every flight is the real client (gate, target filter, mission, safety filter) in a world of its
    seed, and always the same for that seed. A row a flight goes to flights.csv as it ends.

    Exit code 0: every flight was safe: nothing but the tip touched anything, and not beside the
    mouth. 3: some were not, did not end, or could not be flown. What flies without a part does not
    count.

    Example: python -m contact_sim campaign --flights 100 --faults usual --out runs/faults
    """
    console = Console(stderr=True)
    worlds = world or list(WORLDS)
    _check(worlds, board, link, eyes, connect)
    struck: tuple[Fault | None, ...] = () if faults is None else _faults(faults, eyes)
    kinds = ((None,) if plain else ()) + struck
    seeds = range(first_seed, first_seed + flights)
    processes = jobs or os.cpu_count() or 1
    chosen = ABLATIONS if ablations else ()
    planned = plan(worlds, seeds, kinds, chosen, board, link)
    if eyes is EyesName.SERVICE:
        choose_gl()
    with ExitStack() as stack:
        table = Table(out / TABLE_NAME, goes_on=resume, overwrites=overwrite)
        stack.callback(table.close)
        endpoint = connect
        if eyes is EyesName.SERVICE and connect is None:
            console.print("starting a service", highlight=False)
            endpoint = stack.enter_context(ServiceProcess(out)).endpoint
        if endpoint is not None:
            ServiceEyes(endpoint, "campaign").close()  # none there: told before a flight begins
        jobs_planned = [replace(job, endpoint=endpoint) for job in planned]
        bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
        )
        with bar:
            task = bar.add_task("flights", total=len(jobs_planned))
            done = {row.flight for row in table.rows if not row.error}
            bar.advance(task, sum(job.flight in done for job in jobs_planned))

            def on_row(row: FlightRow) -> None:
                bar.advance(task)
                if not row.well:
                    why = row.error or row.collisions or _what(row)
                    console.print(
                        f"{row.world}, seed {row.seed}, {row.fault}, {row.ablation}: {why}",
                        markup=False,
                        highlight=False,
                    )

            fly_campaign(jobs_planned, table, processes, on_row)
        rows = _in_order(table.rows, [job.flight for job in jobs_planned])
    _write_page(rows, out, write, _command(context), eyes, link)
    groups = {" / ".join(key): summary(of) for key, of in by_group(rows).items()}
    if as_json:
        print(json.dumps(groups, indent=2))
    else:
        for key, s in groups.items():
            print(f"{key}: {_line(s)}")
        print(f"table {out / TABLE_NAME}, page {out / PAGE_NAME}")
    if not all(row.well for row in rows if row.ablation == WHOLE or row.error):
        raise typer.Exit(3)


def _check(worlds: list[str], board: str, link: str, eyes: EyesName, connect: str | None) -> None:
    """What was asked for, before anything is started."""
    if board not in BOARDS:
        raise CampaignError(f"no board {board!r}; there are: {', '.join(BOARDS)}")
    for name in worlds:
        if name not in WORLDS:
            raise CampaignError(f"no world {name!r}; there are: {', '.join(WORLDS)}")
    try:
        profile(link)
    except EmulatorError as error:
        raise CampaignError(str(error)) from None
    if eyes is EyesName.MODEL and connect is not None:
        raise CampaignError("--connect is for --eyes service; the model needs no service")


def _what(row: FlightRow) -> str:
    if row.outside_m > 0.0:
        return f"pushed {1e3 * row.outside_m:.1f} mm"
    return f"not given back within {row.flown_s:.0f} s: {row.phase}"


def _line(s: dict[str, Any]) -> str:
    return (
        f"{s['contact']} of {s['flights']} in contact, {s['within_2cm']} within 2 cm, "
        f"{s['retreat']} retreats, {s['collided']} collisions, {s['outside']} pushes outside"
    )


def _faults(text: str, eyes: EyesName) -> tuple[Fault, ...]:
    """The faults asked for; of the usual ones those that these eyes can be struck with."""
    chosen = USUAL if text == USUAL_FAULTS else load_faults(Path(text))
    if eyes is EyesName.MODEL:
        return chosen
    drawn = tuple(fault for fault in chosen if fault.kind is not Kind.OCCLUDED)
    if text != USUAL_FAULTS and drawn != chosen:
        raise CampaignError("occluded is for --eyes model: no picture shows a person")
    return drawn


def _in_order(rows: list[FlightRow], keys: list[Flight]) -> list[FlightRow]:
    """As they were planned; of a flight that was flown twice the last row."""
    newest = {row.flight: row for row in rows}
    return [newest[key] for key in keys if key in newest]


def _command(context: typer.Context) -> str:
    """The command line that flies the same again, without what only says where and how."""
    words = ["python -m contact_sim campaign"]
    for option in context.command.params:
        value, name = context.params[option.name or ""], option.opts[0]
        source = context.get_parameter_source(option.name or "")
        if source is None or source.name != "COMMANDLINE" or option.name in _ELSEWHERE:
            continue
        if value is True:
            words.append(name)
        elif value is False:
            words += option.secondary_opts[:1]
        else:
            words += [f"{name} {v}" for v in (value if isinstance(value, list) else [value])]
    return " ".join(words)


def _write_page(
    rows: list[FlightRow], out: Path, write: Path | None, command: str, eyes: EyesName, link: str
) -> None:
    who = {
        EyesName.SERVICE: "Pictures are drawn, coded, and looked at by a real service process",
        EyesName.MODEL: "Without pictures: the localiser's errors as they were measured",
    }[eyes]
    text = page(rows, command, f"{who}; times on the link are drawn from the profile *{link}*.")
    for path in (out / PAGE_NAME, write):
        if path is None:
            continue
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise CampaignError(f"cannot write {path}: {error.strerror}") from None
