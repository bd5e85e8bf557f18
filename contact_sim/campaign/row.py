"""One flight as a row of a table."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any, Final, NamedTuple

from contact_sim.campaign.faults import Striker
from contact_sim.lockstep.flight import Flown
from drone_client.mission import Phase

UNFINISHED: Final = "unfinished"
AWAY_M: Final = 0.5
"""A tip that is further from the board has come back from it: half the way to the stand-off point,
for a drone whose odometry has fallen silent goes back by its IMU, and drifts."""


class Flight(NamedTuple):
    """What a flight is flown with; tells it from the others of a campaign."""

    world: str
    seed: int
    board: str
    link: str
    eyes: str
    fault: str
    ablation: str


@dataclass(frozen=True, slots=True)
class FlightRow:
    """What one flight came to; lengths in metres, an empty cell where there is nothing to say."""

    world: str
    seed: int
    board: str
    link: str
    eyes: str
    """model or service."""
    fault: str
    ablation: str
    phase: str
    reason: str
    ends: str
    """contact: touched and back. false_contact: the client believes so, and nothing touched.
    retreat: back, without. stands: given back clear of the board.
    touches: given back on it. no_approach: it never began one. unfinished: not given back when
    time was up. failed: it was not flown."""
    attempts: int
    struck_m: float | None
    """Where the fault struck."""
    touched: bool
    offset_m: float | None
    touch_left_m: float | None
    touch_up_m: float | None
    touch_age_s: float | None
    """How old the newest measurement was as it touched."""
    closing_mps: float | None
    peak_force_n: float
    press_force_n: float | None
    pressed_s: float
    outside_m: float
    collisions: str
    nearest_m: float
    end_m: float
    flown_s: float
    drift_m: float
    found: int
    """Frames in which a target was found."""
    frames: int
    accepted: int
    gated: int
    """Results that the gate refused."""
    wall_s: float
    error: str = ""
    """Why there was no flight."""

    @property
    def flight(self) -> Flight:
        """What it was flown with; as ``Job.flight``."""
        return Flight(
            self.world, self.seed, self.board, self.link, self.eyes, self.fault, self.ablation
        )

    @property
    def safe(self) -> bool:
        """Nothing but the tip touched anything, and that not beside the mouth."""
        return not self.collisions and self.outside_m == 0.0 and not self.error

    @property
    def well(self) -> bool:
        """Safe, and over."""
        return self.safe and self.ends != UNFINISHED


NAMES: Final = tuple(field.name for field in fields(FlightRow))


def flight_row(flight: Flight, flown: Flown, striker: Striker | None, wall_s: float) -> FlightRow:
    """The row of a flight."""
    o = flown.outcome
    left, up = (None, None) if o.touch_target_m is None else o.touch_target_m
    if not flown.given_back:
        ends = UNFINISHED
    elif flown.phase is Phase.DONE:
        ends = "contact" if o.touched else "false_contact"
    elif flown.attempts == 0:
        ends = "no_approach"
    elif o.end_m >= AWAY_M:
        ends = "retreat"
    else:
        ends = "stands" if o.end_m > 0.0 else "touches"
    accepted = flown.verdicts.get("accepted", 0)
    return FlightRow(
        *flight,
        phase=flown.phase.value,
        reason=flown.reason.value,
        ends=ends,
        attempts=flown.attempts,
        struck_m=None if striker is None else striker.struck_m,
        touched=o.touched,
        offset_m=o.offset_m,
        touch_left_m=left,
        touch_up_m=up,
        touch_age_s=_age_s(flown, o.touched_ns),
        closing_mps=o.closing_mps,
        peak_force_n=o.peak_force_n,
        press_force_n=o.press_force_n,
        pressed_s=o.pressed_s,
        outside_m=o.outside_m,
        collisions="; ".join(o.collisions),
        nearest_m=o.nearest_m,
        end_m=o.end_m,
        flown_s=o.flown_s,
        drift_m=o.drift_m,
        found=flown.counts.get("target", 0),
        frames=flown.counts.get("sent", 0),
        accepted=accepted,
        gated=sum(flown.verdicts.values()) - accepted,
        wall_s=wall_s,
    )


def _age_s(flown: Flown, t_ns: int | None) -> float | None:
    """Age of what the client knew at its last tick before a time."""
    if t_ns is None:
        return None
    tick = next((tick for tick in reversed(flown.ticks) if tick.t_ns <= t_ns), None)
    if tick is None or tick.decision.age_ns is None:
        return None
    return (tick.decision.age_ns + t_ns - tick.t_ns) / 1e9


def failed_row(flight: Flight, why: str, wall_s: float) -> FlightRow:
    """The row of a flight that could not be flown."""
    return FlightRow(
        *flight,
        phase="",
        reason="",
        ends="failed",
        attempts=0,
        struck_m=None,
        touched=False,
        offset_m=None,
        touch_left_m=None,
        touch_up_m=None,
        touch_age_s=None,
        closing_mps=None,
        peak_force_n=0.0,
        press_force_n=None,
        pressed_s=0.0,
        outside_m=0.0,
        collisions="",
        nearest_m=math.nan,
        end_m=math.nan,
        flown_s=0.0,
        drift_m=math.nan,
        found=0,
        frames=0,
        accepted=0,
        gated=0,
        wall_s=wall_s,
        error=" ".join(why.split())[:300],
    )


def as_cells(row: FlightRow) -> dict[str, Any]:
    """For a CSV file: an empty cell for what is not known."""
    return {k: "" if v is None else v for k, v in asdict(row).items()}


def from_cells(cells: dict[str, str]) -> FlightRow:
    """A row of a CSV file.

    Raises:
        ValueError: a column is missing, or a cell is not what it should be.
    """
    values: dict[str, Any] = {}
    for field in fields(FlightRow):
        text = cells.get(field.name)
        if text is None:
            raise ValueError(f"column {field.name} is missing")
        kind = str(field.type)
        if kind == "str":
            values[field.name] = text
        elif kind == "bool":
            if text not in ("True", "False"):
                raise ValueError(f"{field.name} = {text[:40]!r} is neither True nor False")
            values[field.name] = text == "True"
        elif text == "" and kind.endswith("None"):
            values[field.name] = None
        else:
            values[field.name] = int(text) if kind == "int" else float(text)
    row = FlightRow(**values)
    numbers = (value for value in values.values() if isinstance(value, float))
    if not (row.error or all(map(math.isfinite, numbers))):
        raise ValueError("a number of a flight that was flown is not finite")
    return row
