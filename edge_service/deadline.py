"""Whether a frame's answer can still be of use, and what its drone is told if not.

A frame carries its budget, a duration: what was left of it when it left the drone. So no two clocks
are compared; the time that the frame spent on its way is the drone's to subtract.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from enum import Enum, auto

from edge_service.pipeline import Output
from edge_service.service_time import ServiceTime
from rgbd_wire.messages import Outcome

TRY_EVERY_NS = 250_000_000
"""So often a frame is served although it should be late: what is expected may be wrong, and only
a frame that is served can show it. It costs at most four frames a second, however many drones."""


class Ruling(Enum):
    """What is to become of a frame."""

    SERVE = auto()
    TRY = auto()
    """Serve it: it should be late, but nobody has looked for a while whether that is still so."""
    DROP = auto()


@dataclass(frozen=True, slots=True)
class Prospect:
    """Where a frame stands, in durations on the worker's clock."""

    waited_ns: int
    """Since its last byte came in (t2)."""
    expected_ns: int
    """What it would still take."""
    budget_ns: int

    @property
    def makes_it(self) -> bool:
        """Its answer leaves within the budget, as far as one can tell."""
        return self.waited_ns + self.expected_ns <= self.budget_ns

    @property
    def is_over(self) -> bool:
        """The budget is spent, whatever is expected."""
        return self.waited_ns > self.budget_ns

    def dropped(self) -> Output:
        """The answer to a frame that is dropped, with the numbers that say why."""
        waited, takes, budget = (
            round(ns / 1e6) for ns in (self.waited_ns, self.expected_ns, self.budget_ns)
        )
        return Output(
            Outcome.DROPPED,
            f"waited {waited} ms, service takes {takes} ms, budget {budget} ms",
        )


class Deadline:
    """Rules on frames, from any thread.

    Args:
        times: what frames take.
    """

    def __init__(self, times: ServiceTime) -> None:
        self._times = times
        self._lock = threading.Lock()
        self._tried_ns: int | None = None

    def rule(
        self, waited_ns: int, budget_ns: int, now_ns: int, *, is_try: bool = False
    ) -> tuple[Ruling, Prospect]:
        """What is to become of a frame, and where it stands.

        Args:
            waited_ns: since it came in.
            budget_ns: as its header says.
            now_ns: worker's clock.
            is_try: it has been ruled to be one before.
        """
        prospect = Prospect(waited_ns, self._times.expected_ns(now_ns), budget_ns)
        if prospect.makes_it:
            return Ruling.SERVE, prospect
        if prospect.is_over or not (is_try or self._may_try(now_ns)):
            return Ruling.DROP, prospect
        return Ruling.TRY, prospect

    def _may_try(self, now_ns: int) -> bool:
        with self._lock:
            if self._tried_ns is not None and now_ns - self._tried_ns < TRY_EVERY_NS:
                return False
            self._tried_ns = now_ns
        return True
