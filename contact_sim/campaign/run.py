"""Flights in parallel processes, one row each, as they come."""

from __future__ import annotations

import csv
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

from contact_sim.campaign.faults import Fault, Striker, fault_name, strikes
from contact_sim.campaign.row import (
    NAMES,
    Flight,
    FlightRow,
    as_cells,
    failed_row,
    flight_row,
    from_cells,
)
from contact_sim.chance import stream
from contact_sim.errors import CampaignError, ServiceError, SimulatorError
from contact_sim.lockstep.eyes import Eyes, ModelEyes
from contact_sim.lockstep.flight import LockstepFlight, LockstepSettings
from contact_sim.lockstep.service_eyes import ServiceEyes
from contact_sim.scene import build_scene
from contact_sim.sensing import d455
from drone_client.cbf import FilterSettings
from link_emulator.profiles import profile

WHOLE: Final = "none"
"""Nothing is left out."""
ABLATIONS: Final = ("composes_now", "no_gate", "no_age", "no_funnel")
"""What is left out: capture-time composition, the delay gate, gate and age of what is known, the
funnel."""
HOPELESS: Final = 3
"""When so many flights, the first ones, cannot be flown, no other will."""
NO_AGE_NS: Final = 2_000_000_000
"""Knowledge so old is good enough: the most that the filter takes."""
NO_FUNNEL_M: Final = 0.5
"""A mouth so wide that it is none: the largest that the funnel takes."""


@dataclass(frozen=True, slots=True)
class Job:
    """One flight."""

    world: str
    seed: int
    board: str
    link: str
    fault: Fault | None = None
    ablation: str = WHOLE
    endpoint: str | None = None
    """Of the service whose eyes look; None: the model's."""

    @property
    def flight(self) -> Flight:
        """What tells it from the others of a campaign."""
        eyes = "model" if self.endpoint is None else "service"
        return Flight(
            self.world,
            self.seed,
            self.board,
            self.link,
            eyes,
            fault_name(self.fault),
            self.ablation,
        )


def ablated(settings: LockstepSettings, ablation: str) -> LockstepSettings:
    """The settings without a part of the contract.

    Raises:
        CampaignError: there is no such part.
    """
    limits = settings.parts.control.filter
    match ablation:
        case _ if ablation == WHOLE:
            return settings
        case "composes_now":
            return replace(settings, composes_now=True)
        case "no_gate":
            return replace(settings, gates=False)
        case "no_age":
            late = limits.with_age_max(NO_AGE_NS)
            return _filtered(replace(settings, gates=False), replace(late, drift_mps=0.0))
        case "no_funnel":
            return _filtered(
                settings, replace(limits, funnel=replace(limits.funnel, r_c_m=NO_FUNNEL_M))
            )
        case _:
            raise CampaignError(f"no ablation {ablation!r}; there are: {', '.join(ABLATIONS)}")


def _filtered(settings: LockstepSettings, limits: FilterSettings) -> LockstepSettings:
    control = replace(settings.parts.control, filter=limits)
    return replace(settings, parts=replace(settings.parts, control=control))


def fly_job(job: Job) -> FlightRow:
    """Fly one; what goes wrong is a row with its error, so that the others go on.

    Also what nobody thought of: a night of flights does not end with one of them.
    """
    began = time.monotonic()
    eyes: ServiceEyes | None = None
    try:
        scene = build_scene(job.world, job.seed, job.board)
        rig = d455()
        if job.endpoint is not None:
            eyes = ServiceEyes(job.endpoint, f"campaign-{os.getpid()}")
        looking: Eyes = eyes or ModelEyes(rig.color, stream(job.seed, "eyes"))
        flight = LockstepFlight(
            scene,
            job.seed,
            profile(job.link),
            lambda simulation: looking,
            rig,
            ablated(LockstepSettings(), job.ablation),
        )
        striker = None if job.fault is None else Striker(job.fault, job.seed)
        flown = flight.fly(striker or (lambda flight: None))
        wall_s = time.monotonic() - began
        return flight_row(job.flight, flown, striker, wall_s)
    except SimulatorError as error:
        return failed_row(job.flight, str(error), time.monotonic() - began)
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        return failed_row(job.flight, why, time.monotonic() - began)
    finally:
        if eyes is not None:
            eyes.close()


class Table:
    """The rows on disk: kept as they come, read when a campaign goes on.

    Raises:
        CampaignError: the file cannot be written, is there already, or is no table of flights.
    """

    def __init__(self, path: Path, *, goes_on: bool, overwrites: bool = False) -> None:
        self.rows: list[FlightRow] = []
        self._path = path
        try:
            there = path.exists()
        except OSError as error:
            raise CampaignError(f"cannot write {path}: {error.strerror}") from None
        if there and not overwrites:
            if not goes_on:
                raise CampaignError(
                    f"{path} is there already: --resume goes on after its flights, --overwrite "
                    "throws them away, --out takes another folder"
                )
            self.rows = read_table(path)
        # What has been flown is never lost: the new table is whole before it takes the old one's
        # place
        beside = path.with_name(path.name + ".part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = beside.open("w", encoding="utf-8", newline="")
        except OSError as error:
            raise CampaignError(f"cannot write {path}: {error.strerror}") from None
        self._writer = csv.DictWriter(self._file, NAMES)
        try:
            self._writer.writeheader()
            self._writer.writerows(as_cells(row) for row in self.rows)
            self._file.flush()
            beside.replace(path)
        except OSError as error:
            self.close()
            with suppress(OSError):
                beside.unlink()
            raise CampaignError(f"cannot write {path}: {error.strerror}") from None

    def add(self, row: FlightRow) -> None:
        """Keep a row; whole, whatever happens next."""
        self.rows.append(row)
        try:
            self._writer.writerow(as_cells(row))
            self._file.flush()
        except OSError as error:
            raise CampaignError(
                f"cannot write {self._path} any more: {error.strerror}; its {len(self.rows) - 1} "
                "rows so far are whole, --resume goes on after them"
            ) from None

    def close(self) -> None:
        """Close the file."""
        with suppress(OSError):
            self._file.close()


def read_table(path: Path) -> list[FlightRow]:
    """The rows of a table; a last line that was cut off is left out.

    Raises:
        CampaignError: it cannot be read, or is no table of flights.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            lines = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        why = getattr(error, "strerror", None) or error
        raise CampaignError(f"cannot read {path}: {why}") from None
    if lacks := [name for name in NAMES if name not in (reader.fieldnames or ())]:
        raise CampaignError(f"{path} is no table of flights: column {lacks[0]} is missing")
    rows = []
    for number, cells in enumerate(lines, 2):
        try:
            rows.append(from_cells(cells))
        except (ValueError, TypeError) as error:
            if number == len(lines) + 1:
                break
            raise CampaignError(f"{path}, line {number}: {error}") from None
    return rows


def fly_all(jobs: Sequence[Job], processes: int) -> Iterator[FlightRow]:
    """Fly them, several at once; rows come as flights end.

    Raises:
        CampaignError: a process died.
    """
    if processes <= 1:
        yield from map(fly_job, jobs)
        return
    # Nothing of this process's threads and GL may be inherited
    context = multiprocessing.get_context("spawn")
    held, holding = context.Pipe(duplex=False)
    with (
        held,
        ProcessPoolExecutor(processes, context, initializer=_end_with, initargs=(held,)) as pool,
        holding,  # closed first: the pool by itself would wait for the flights that are in the air
    ):
        futures: list[Future[FlightRow]] = [pool.submit(fly_job, job) for job in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        except (OSError, RuntimeError) as error:
            raise CampaignError(f"a process of the campaign died: {error}") from None


def _end_with(held: Connection) -> None:
    """End this process, in mid-flight, as soon as the other end of a pipe is closed.

    That is when the campaign is over or broken off, and when its process is killed.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is the campaign's to take

    def watch() -> None:
        with suppress(EOFError, OSError):
            held.recv()
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="end with the campaign").start()


def plan(
    worlds: Sequence[str],
    seeds: Sequence[int],
    faults: Sequence[Fault | None],
    ablations: Sequence[str],
    board: str,
    link: str,
) -> list[Job]:
    """Every flight of a campaign, once: each ablation with every fault that there can be, too.

    Raises:
        CampaignError: there is no such ablation, or nothing to fly.
    """
    for ablation in ablations:
        ablated(LockstepSettings(), ablation)
    jobs = [
        Job(world, seed, board, link, fault, ablation)
        for ablation in (WHOLE, *ablations)
        for world in dict.fromkeys(worlds)
        for fault in faults
        if strikes(fault, world)
        for seed in seeds
    ]
    if not jobs:
        raise CampaignError("there is nothing to fly: no fault, and none without one")
    return jobs


def fly_campaign(
    jobs: Sequence[Job],
    table: Table,
    processes: int,
    on_row: Callable[[FlightRow], None] = lambda row: None,
) -> None:
    """Fly what the table lacks.

    Raises:
        CampaignError: the table cannot be written any more, or a process died.
        ServiceError: no flight at all could be flown with the service.
    """
    done = {row.flight for row in table.rows if not row.error}
    left = [job for job in jobs if job.flight not in done]
    failed = 0
    for row in fly_all(left, processes):
        table.add(row)
        on_row(row)
        failed = failed + 1 if row.error and failed >= 0 else -1  # one that flies: no fault of all
        if failed >= HOPELESS:
            raise ServiceError(f"no flight succeeds; the last: {row.error}")
