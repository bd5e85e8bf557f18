"""What the figures share: flights that are flown once, and a service that is started once."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import Final, Self

from contact_sim.campaign.row import FlightRow
from contact_sim.campaign.run import fly_all, plan, read_table
from contact_sim.errors import FigureError
from contact_sim.figures.run import Run, fly
from contact_sim.flight.service import ServiceProcess
from contact_sim.lockstep.eyes import Eyes
from contact_sim.lockstep.service_eyes import ServiceEyes
from contact_sim.scene import WORLDS, build_scene

LINK: Final = "wifi"
RUN_1: Final = ("tunnel", 3)
"""Starts outside the funnel: 2.4 m before the board, 1.2 m beside its axis."""
RUN_2: Final = ("refinery", 18)
"""Starts inside."""
QUICK_FLIGHTS: Final = 2
MODEL_WORDS: Final = "with a localiser's measured errors instead of pictures"
SERVICE_WORDS: Final = "with pictures through a real service"


class FigureBench:
    """Flies and looks on demand; a context that ends what it started.

    Raises:
        CampaignError: the table of a campaign cannot be read.
        FigureError: it holds no flight that could be drawn.
    """

    def __init__(
        self,
        *,
        quick: bool = False,
        pictures: bool = False,
        connect: str | None = None,
        table: Path | None = None,
        flights: int = 100,
        jobs: int = 2,
        scratch: Path = Path("runs/figures"),
        tell: Callable[[str, int, int], None] = lambda what, done, of: None,
    ) -> None:
        """Nothing is flown yet.

        Args:
            quick: few flights, few pictures: shows that all works, and little else.
            pictures: runs 1 and 2 through a real service, instead of a model of a localiser.
            connect: endpoint of a service that runs; None: one is started when it is needed.
            table: flights.csv of a campaign, whose flights without faults are the many.
            flights: how many in each world, where there is no table.
            jobs: processes for them.
            scratch: folder for the log of a service.
            tell: called with what goes on, how much of it is done, and how much there is.
        """
        self.quick = quick
        self.tell = tell
        self._pictures = pictures
        self._connect = connect
        self._flown = None if table is None else _without_faults(table)
        self._flights = min(flights, QUICK_FLIGHTS) if quick else flights
        self._jobs = jobs
        self._scratch = scratch
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @cached_property
    def service(self) -> ServiceEyes:
        """A real service, started when first asked for."""
        endpoint = self._connect
        if endpoint is None:
            self.tell("a service starts", 0, 1)
            endpoint = self._stack.enter_context(ServiceProcess(self._scratch)).endpoint
        return self._stack.enter_context(ServiceEyes(endpoint, "figures"))

    @cached_property
    def run_1(self) -> Run:
        """In the tunnel, from outside the safe set."""
        return self._run("run 1 (tunnel)", *RUN_1)

    @cached_property
    def run_2(self) -> Run:
        """In the refinery, from inside."""
        return self._run("run 2 (refinery)", *RUN_2)

    @property
    def runs(self) -> tuple[Run, Run]:
        """Both of the paper's."""
        return self.run_1, self.run_2

    @property
    def eyes_words(self) -> str:
        """Who looked in runs 1 and 2, for a caption."""
        return SERVICE_WORDS if self._pictures else MODEL_WORDS

    @property
    def many_eyes_words(self) -> str:
        """Who looked in the many, for a caption."""
        eyes = {row.eyes for row in self.many}
        if eyes == {"model"}:
            return MODEL_WORDS
        return SERVICE_WORDS if eyes == {"service"} else f"{MODEL_WORDS}, some {SERVICE_WORDS}"

    @cached_property
    def many(self) -> list[FlightRow]:
        """Flights without faults, in both worlds."""
        if self._flown is not None:
            return self._flown
        jobs = plan(WORLDS, range(self._flights), (None,), (), "clean", LINK)
        rows = []
        for row in fly_all(jobs, self._jobs):
            rows.append(row)
            self.tell("flights", len(rows), len(jobs))
        if failed := next((row.error for row in rows if row.error), None):
            raise FigureError(f"a flight could not be flown: {failed}")
        return sorted(rows, key=lambda row: (row.world, row.seed))

    def _run(self, label: str, world: str, seed: int) -> Run:
        self.tell(label, 0, 1)
        eyes: Eyes | None = self.service if self._pictures else None
        return fly(label, build_scene(world, seed), seed, LINK, eyes)


def _without_faults(table: Path) -> list[FlightRow]:
    rows = [
        row
        for row in read_table(table)
        if row.fault == "none" and row.ablation == "none" and not row.error
    ]
    if not rows:
        raise FigureError(
            f"{table} holds no flight without a fault: fly some with "
            "python -m contact_sim campaign --plain"
        )
    return rows
