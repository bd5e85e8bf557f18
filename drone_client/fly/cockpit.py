"""What the person in charge sees of a flight, and is asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drone_client.autopilot import VehicleState
from drone_client.control import Decision
from drone_client.tally import Tally


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """How things are, some times a second."""

    vehicle: VehicleState | None
    decision: Decision | None
    """Of the newest control tick."""
    tally: Tally
    workers: tuple[str, ...]


class Cockpit(Protocol):
    """The person's side; called on the main thread."""

    def may_fly(self, view: View) -> bool:
        """Ask whether to take the vehicle; blocks as long as the person thinks."""
        ...

    def show(self, view: View) -> None:
        """Show how things are."""
        ...

    def tell(self, sentence: str) -> None:
        """Tell what has happened."""
        ...
