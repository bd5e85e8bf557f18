"""What goes wrong in a flight, and when: chosen by the seed, switched between two ticks."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np

from contact_sim.chance import stream
from contact_sim.errors import CampaignError
from contact_sim.lockstep.eyes import ModelEyes
from contact_sim.lockstep.flight import LockstepFlight
from drone_client.mission import Phase

LAMPLIT: Final = frozenset({"tunnel"})
MAX_FILE_BYTES: Final = 65_536
CLOCK_STEP_NS: Final = 3_600_000_000_000


class Kind(StrEnum):
    """Of a fault."""

    WORKER_KILLED = "worker_killed"
    """It answers nothing more, and no other takes over."""
    WORKER_HANGS = "worker_hangs"
    """It takes frames and acknowledges them, and answers none."""
    BLACK_HOLE = "black_hole"
    """Nothing passes the link, in either direction."""
    LINK_SLOW = "link_slow"
    """Both directions take longer."""
    VIO_JUMPS = "vio_jumps"
    """The odometry's world moves."""
    VIO_OUT = "vio_out"
    """The odometry falls silent."""
    LAMP_OUT = "lamp_out"
    """Every lamp of the world goes out."""
    GUST = "gust"
    """A gust of wind, from anywhere."""
    OCCLUDED = "occluded"
    """Somebody stands before the board."""
    CAMERA_FROZEN = "camera_frozen"
    """The camera gives one picture again and again, with new stamps."""
    CLOCK_STEP = "clock_step"
    """The worker's clock is set by an hour."""


SIZES: Final = {Kind.VIO_JUMPS: 0.3, Kind.GUST: 0.3, Kind.LINK_SLOW: 0.2}
"""Of the kinds that have one, when a fault does not say: metres; ten times metres per second;
seconds each way."""
FOR_GOOD: Final = frozenset(
    {Kind.WORKER_KILLED, Kind.VIO_JUMPS, Kind.LAMP_OUT, Kind.CAMERA_FROZEN, Kind.CLOCK_STEP}
)
"""What is never over: ``for_s`` says nothing."""
GUST_S: Final = 1.5


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault; it strikes once, at a random place of the approach.

    Raises:
        CampaignError: a number is out of its bounds, or says nothing for this kind.
    """

    kind: Kind
    nearest_m: float = 0.0
    """The distance of the tip at which it strikes is drawn between the two."""
    farthest_m: float = 0.9
    for_s: float | None = None
    """Then it is over; None: a gust after 1.5 s, anything else never."""
    size: float | None = None
    """vio_jumps: metres; gust: ten times metres per second; link_slow: seconds each way."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.nearest_m <= self.farthest_m <= 10.0:
            raise CampaignError(
                f"{self.kind}: 0 <= nearest_m = {self.nearest_m:g} <= farthest_m = "
                f"{self.farthest_m:g} <= 10 does not hold"
            )
        if self.for_s is not None and self.kind in FOR_GOOD:
            raise CampaignError(f"{self.kind} is never over: it takes no for_s")
        if self.for_s is not None and not 0.0 < self.for_s <= 3600.0:
            raise CampaignError(f"{self.kind}: for_s = {self.for_s:g} must be in (0, 3600]")
        if self.size is not None and self.kind not in SIZES:
            raise CampaignError(f"{self.kind} takes no size; {', '.join(SIZES)} do")
        if self.size is not None and not 0.0 < self.size <= 2.0:
            raise CampaignError(f"{self.kind}: size = {self.size:g} must be in (0, 2]")

    @property
    def seconds(self) -> float:
        """How long it lasts; infinite: for good."""
        if self.for_s is not None:
            return self.for_s
        return GUST_S if self.kind is Kind.GUST else math.inf

    @property
    def amount(self) -> float:
        """Its size; zero for a kind that has none."""
        return SIZES.get(self.kind, 0.0) if self.size is None else self.size


USUAL: Final = (
    Fault(Kind.WORKER_KILLED),
    Fault(Kind.WORKER_HANGS),
    Fault(Kind.BLACK_HOLE),
    Fault(Kind.BLACK_HOLE, for_s=1.0),
    Fault(Kind.LINK_SLOW, for_s=6.0),
    Fault(Kind.VIO_JUMPS),
    Fault(Kind.VIO_OUT),
    Fault(Kind.LAMP_OUT),
    Fault(Kind.GUST),
    Fault(Kind.OCCLUDED, for_s=3.0),
    Fault(Kind.CAMERA_FROZEN),
    Fault(Kind.CLOCK_STEP),
)
"""What a campaign looks at when no file says otherwise."""


def fault_name(fault: Fault | None) -> str:
    """For a table: the kind, and what is not as it is by default; no two faults share one."""
    if fault is None:
        return "none"
    usual = Fault(fault.kind)
    words = [fault.kind.value]
    words += [f"of {fault.amount:g}"] if fault.amount != usual.amount else []
    words += [f"{fault.seconds:g}s"] if not math.isinf(fault.seconds) else []
    place = fault.nearest_m, fault.farthest_m
    if place != (usual.nearest_m, usual.farthest_m):
        words.append(f"at {place[0]:g}-{place[1]:g} m")
    return " ".join(words)


def strikes(fault: Fault | None, world: str) -> bool:
    """Whether there is anything in a world for a fault to strike: no lamps burn in daylight."""
    return fault is None or fault.kind is not Kind.LAMP_OUT or world in LAMPLIT


class Striker:
    """Waits for its place in the flight, strikes, and ends it when its time is over."""

    def __init__(self, fault: Fault, seed: int) -> None:
        self.struck_ns: int | None = None
        """Simulated time at which it struck; None: it has not."""
        self.struck_m: float | None = None
        """Distance of the tip then, as the client believed."""
        rng = stream(seed, "fault")
        self._fault = fault
        self._at_m = float(rng.uniform(fault.nearest_m, fault.farthest_m))
        self._direction = rng.standard_normal(3)
        self._direction /= np.linalg.norm(self._direction)
        self._ended = False

    def __call__(self, flight: LockstepFlight) -> None:
        """Before every tick."""
        now_ns = flight.simulation.t_ns
        if self.struck_ns is None:
            distance_m = flight.tip_distance_m
            near = flight.phase in (Phase.APPROACH, Phase.CONTACT)
            if near and distance_m is not None and distance_m <= self._at_m:
                self.struck_ns, self.struck_m = now_ns, distance_m
                self._switch(flight, on=True)
        elif not self._ended and now_ns - self.struck_ns >= self._fault.seconds * 1e9:
            self._ended = True
            self._switch(flight, on=False)

    def _switch(self, flight: LockstepFlight, *, on: bool) -> None:
        match self._fault.kind:
            case Kind.WORKER_KILLED:
                flight.worker.kill(flight.simulation.t_ns if on else None)
            case Kind.WORKER_HANGS:
                flight.worker.hangs = on
            case Kind.CLOCK_STEP:
                flight.worker.clock_step_ns = CLOCK_STEP_NS if on else 0
            case Kind.BLACK_HOLE:
                flight.link.cut(cut=on)
            case Kind.LINK_SLOW:
                flight.link.slow(self._fault.amount if on else 0.0)
            case Kind.CAMERA_FROZEN:
                flight.frozen = on
            case _:
                self._switch_world(flight, on=on)

    def _switch_world(self, flight: LockstepFlight, *, on: bool) -> None:
        match self._fault.kind:
            case Kind.VIO_OUT:
                flight.simulation.vio_camera.out(on)
            case Kind.OCCLUDED:
                self._occlude(flight, on)
            case Kind.VIO_JUMPS if on:
                flight.simulation.vio_camera.jump((self._fault.amount * self._direction).tolist())
            case Kind.GUST if on:
                self._gust(flight)
            case Kind.LAMP_OUT if on:
                self._lamps_out(flight)
            case _:
                pass  # what has struck once needs no end

    def _gust(self, flight: LockstepFlight) -> None:
        x, y, z = self._direction.tolist()
        level = x, y, 0.3 * z
        scale = 10.0 * self._fault.amount / math.hypot(*level)
        velocity = scale * level[0], scale * level[1], scale * level[2]
        flight.simulation.wind.gust(velocity, self._fault.seconds)

    def _lamps_out(self, flight: LockstepFlight) -> None:
        for lamp in flight.scene.lamps:
            flight.simulation.lamp_out(lamp)
        if isinstance(flight.eyes, ModelEyes):
            flight.eyes.dark = True

    def _occlude(self, flight: LockstepFlight, on: bool) -> None:
        if not isinstance(flight.eyes, ModelEyes):
            raise CampaignError("occluded: only --eyes model knows how; pictures show no person")
        flight.eyes.occluded = on


def load_faults(path: Path) -> tuple[Fault, ...]:
    """Faults of a TOML file: a ``[[fault]]`` with ``kind`` and numbers for each.

    Raises:
        CampaignError: with the path, the field at fault and what it may be.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        if len(data) > MAX_FILE_BYTES:
            raise CampaignError(f"over {MAX_FILE_BYTES} bytes")
        raw = tomllib.loads(data.decode("utf-8"))
        if set(raw) != {"fault"} or not isinstance(raw["fault"], list):
            raise CampaignError("a file of faults holds [[fault]] tables and nothing else")
        faults = tuple(_fault(table) for table in raw["fault"])
        names = [fault_name(fault) for fault in faults]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise CampaignError(f"twice the same: {', '.join(twice)}")
        if not faults:
            raise CampaignError("a file of faults holds at least one [[fault]]")
        return faults
    except OSError as error:
        raise CampaignError(f"faults {path}: {error.strerror}") from None
    except (ValueError, OverflowError, RecursionError, CampaignError) as error:
        raise CampaignError(f"faults {path}: {error}") from None


def _fault(table: Any) -> Fault:
    if not isinstance(table, dict) or "kind" not in table:
        raise CampaignError("a [[fault]] lacks its kind")
    kinds = [k.value for k in Kind]
    if table["kind"] not in kinds:
        raise CampaignError(f"no fault {str(table['kind'])[:40]!r}; there are: {', '.join(kinds)}")
    known = ("nearest_m", "farthest_m", "for_s", "size")
    numbers: dict[str, float] = {}
    for key, value in table.items():
        if key == "kind":
            continue
        if key not in known:
            raise CampaignError(f"{table['kind']} has unknown {key[:40]!r}; known: {known}")
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise CampaignError(f"{table['kind']}: {key} = {str(value)[:40]} is no number")
        numbers[key] = float(value)
    return Fault(Kind(table["kind"]), **numbers)
