"""Very many simulated approaches, in chunks that can be resumed: what each asks, and one row each.

A chunk is a function of its trial's name, its number and nothing else, so that a run that was
broken off goes on where it was, and any row can be flown again.
"""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import os
import random
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from drone_client.cbf import BodyPart, FilterSettings, Funnel, KeepOut
from drone_client.cbf.vector import Vec3
from drone_client.guidance import GuidanceSettings
from tests.perf.bench_control_flight import Flight, Start, Tick, World, fly

ROOT = Path(__file__).parents[2]
SOURCES = (
    *sorted((ROOT / "drone_client/cbf").glob("*.py")),
    ROOT / "drone_client/guidance.py",
    ROOT / "drone_client/target.py",
    Path(__file__).with_name("bench_control_flight.py"),
    Path(__file__),
)
CHUNK = 200
"""Flights; some seconds."""
BRAKES_IN_NS = 100_000_000
LOOSE = World(quick_eyes=True, seconds=12.0)
"""What the forward invariance is asked for: 1 cm of noise, 150 ms, 0.3 s."""
LOCALISER = World(noise_m=0.0005, noise_per_m=0.001, noise_rad=0.004)
"""About what docs/results/localiser.md measures, doubled."""
WIDE = FilterSettings(funnel=Funnel(r_c_m=0.03))
HASTY = GuidanceSettings(k_x=0.8, k_lateral=0.8, touch_mps=0.1, press_mps=0.1)
"""As fast as its bounds let it."""
PROPELLERS = tuple(
    BodyPart((x, y, 0.06), 0.19, (0.0, 0.0, 1.0)) for x in (-0.2, 0.2) for y in (-0.2, 0.2)
)
WALL = KeepOut("wall", PROPELLERS, clearance_m=0.10)
TUNNEL = (
    WALL,
    KeepOut("other wall", PROPELLERS, (-1.0, 0.0, 0.0), -1.7),
    KeepOut("floor", PROPELLERS, (0.0, 0.0, 1.0), -0.3),
    KeepOut("ceiling", PROPELLERS, (0.0, 0.0, -1.0), -0.3),
)
"""So narrow that a retreat does not reach the stand-off distance."""


def inside(rng: random.Random) -> Vec3:
    """A tip in the funnel, 0.15 to 2 m from the board, as often near as far."""
    funnel = Funnel()
    while True:
        x = 0.15 * (2.0 / 0.15) ** rng.random()
        p = (x, rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6))
        if funnel.h(p) >= 0.0:
            return p


def in_tunnel(rng: random.Random) -> Vec3:
    """A tip outside the funnel or in it, its body clear of the tunnel's sides."""
    return rng.uniform(0.1, 0.5), rng.uniform(-0.3, 0.3), rng.uniform(-0.1, 0.05)


def outside(rng: random.Random) -> Vec3:
    """A tip outside the funnel, all around the half-space before the board, its body too."""
    funnel = Funnel()
    while True:
        range_m, azimuth = 0.2 * (3.0 / 0.2) ** rng.random(), rng.uniform(-math.pi, math.pi)
        sine = rng.uniform(0.0, 1.0)
        across = range_m * math.sqrt(1.0 - sine * sine)
        p = (range_m * sine, across * math.cos(azimuth), across * math.sin(azimuth))
        if p[0] >= 0.05 and funnel.h(p) < 0.0:
            return p


@dataclass(frozen=True)
class Trial:
    """One question, flown many times."""

    world: World
    flights: int
    """In a full run."""
    limits: FilterSettings = field(default_factory=FilterSettings)
    guidance: GuidanceSettings = field(default_factory=GuidanceSettings)
    keep_outs: tuple[KeepOut, ...] = ()
    start: Callable[[random.Random], Vec3] = inside
    loses_link: bool = False


TRIALS = {
    "invariance": Trial(LOOSE, 20_000),
    "invariance, mouth 30 mm": Trial(LOOSE, 78_000, WIDE),
    "invariance, whole target filter": Trial(World(seconds=12.0), 500),
    "invariance, mouth 30 mm, whole target filter": Trial(World(seconds=12.0), 1_500, WIDE),
    "hasty guidance": Trial(LOOSE, 2_000, WIDE, HASTY),
    "outside": Trial(
        World(0.3, 0.15, 15.0, 0.0005, 0.001, 0.004, seconds=40.0, quick_eyes=True),
        5_000,
        keep_outs=(WALL,),
        start=outside,
    ),
    "link lost": Trial(
        World(0.3, 0.15, 15.0, 0.0005, 0.001, 0.004, seconds=25.0, quick_eyes=True),
        10_000,
        loses_link=True,
    ),
    "tunnel": Trial(
        World(0.3, 0.15, 15.0, 0.0005, 0.001, 0.004, seconds=16.0, quick_eyes=True),
        2_000,
        keep_outs=TUNNEL,
        start=in_tunnel,
        loses_link=True,
    ),
    "contact": Trial(LOCALISER, 1_000),
}


class Chunk(NamedTuple):
    """Which flights of which trial."""

    name: str
    number: int
    flights: int

    @property
    def key(self) -> str:
        """What it is kept under."""
        return f"{self.name}/{self.number}/{self.flights}"


def chunks(share: float) -> list[Chunk]:
    """The whole run, or a share of each trial."""
    found = []
    for name, trial in TRIALS.items():
        left, number = max(1, round(share * trial.flights)), 0
        while left > 0:
            found.append(Chunk(name, number, min(CHUNK, left)))
            left, number = left - CHUNK, number + 1
    return found


def run(
    wanted: list[Chunk], jobs: int, kept: Path | None, step: Callable[[int], None]
) -> dict[str, list[dict[str, Any]]]:
    """Rows of all flights by trial; what ``kept`` holds already is not flown again.

    Raises:
        ValueError: ``kept`` was written by other sources.
    """
    done = {} if kept is None else _read(kept)
    step(sum(chunk.flights for chunk in wanted if chunk.key in done))
    left = [chunk for chunk in wanted if chunk.key not in done]
    for chunk, rows in _flown(left, jobs):
        done[chunk.key] = rows
        if kept is not None:
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps([chunk.key, rows]) + "\n")
        step(chunk.flights)
    by_trial: dict[str, list[dict[str, Any]]] = {}
    for chunk in wanted:
        by_trial.setdefault(chunk.name, []).extend(done[chunk.key])
    return by_trial


def _flown(left: list[Chunk], jobs: int) -> Iterator[tuple[Chunk, list[dict[str, Any]]]]:
    if jobs == 1:
        for chunk in left:
            yield chunk, fly_chunk(chunk)
        return
    # spawn: a fork would copy the progress bar's thread
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_one_thread) as pool:
        waiting = {pool.submit(fly_chunk, chunk): chunk for chunk in left}
        for future in as_completed(waiting):
            yield waiting[future], future.result()


def _one_thread() -> None:
    os.environ["OMP_NUM_THREADS"] = "1"


def fingerprint() -> str:
    """Of everything that a row depends on."""
    digest = hashlib.sha256()
    for source in SOURCES:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


def _read(kept: Path) -> dict[str, list[dict[str, Any]]]:
    if not kept.exists():
        kept.write_text(json.dumps(fingerprint()) + "\n", encoding="utf-8")
        return {}
    first, *lines = kept.read_text(encoding="utf-8").splitlines()
    if json.loads(first) != fingerprint():
        raise ValueError(f"{kept} is of other sources than these: delete it, or name another file")
    done = {}
    for line in lines:
        try:
            key, rows = json.loads(line)
        except ValueError:
            continue  # the end of a run that was broken off
        done[key] = rows
    return done


def fly_chunk(chunk: Chunk) -> list[dict[str, Any]]:
    """One row a flight."""
    trial = TRIALS[chunk.name]
    return [
        _row(trial, seed_of(chunk.name, chunk.number * CHUNK + i)) for i in range(chunk.flights)
    ]


def seed_of(name: str, number: int) -> int:
    """Of the flight's start and noise."""
    return int.from_bytes(hashlib.sha256(f"{name}/{number}".encode()).digest()[:6], "big")


def _row(trial: Trial, seed: int) -> dict[str, Any]:
    rng = random.Random(seed)
    lost_s = rng.uniform(0.3, 12.0) if trial.loses_link else math.inf
    start = Start(trial.start(rng), rng.uniform(-0.4, 0.4), seed, lost_s)
    flight = fly(
        start,
        trial.world,
        trial.limits,
        trial.guidance,
        trial.keep_outs,
        keep_ticks=trial.loses_link,
        ends_pressed=not trial.loses_link,
    )
    row: dict[str, Any] = {"seed": seed, "touched": flight.touch is not None}
    if flight.touch is not None:
        _, y, z = flight.touch.tip
        row |= {
            "beside_m": math.hypot(y, z),
            "closing_mps": -flight.touch.velocity[0],
            "outside_m": flight.outside_m,
        }
    if flight.last is not None:
        x, y, z = flight.last.tip
        row |= {"last_m": [x, y, z], "h_last": trial.limits.funnel.h((x, y, z))}
    if trial.keep_outs:
        row["gap_m"] = flight.least_gap_m
    if trial.loses_link:
        row |= link_lost(flight, trial.limits)
    return {k: _short(v) for k, v in row.items()}


def link_lost(flight: Flight, limits: FilterSettings) -> dict[str, Any]:
    """How a drone brakes and retreats whose link is silent from some moment on.

    ``approach_mps``: fastest commanded approach while knowledge is not fresh. ``brake_late_ms``:
    how long after the hold limit anything but standing or moving straight out was commanded.
    ``coasting_mps``: how fast the vehicle itself still closes in 100 ms after that limit.
    ``lost_m``: how far it came nearer again once it retreats. ``out_m``: where it ended.
    """
    hold_ns, period_ns = limits.hold_ns, round(limits.period_s * 1e9)
    approach, late_ns, coasting, lost, furthest = 0.0, 0, 0.0, 0.0, -math.inf
    for tick in flight.ticks:
        if tick.age_ns <= limits.age_max_ns:
            continue
        approach = max(approach, -tick.tip_command[0])
        if tick.age_ns > hold_ns and not _straight_out(tick):
            late_ns = max(late_ns, tick.age_ns + period_ns - hold_ns)
        if tick.age_ns > hold_ns + BRAKES_IN_NS:
            coasting = max(coasting, -tick.velocity[0])
        if tick.age_ns > limits.retreat_ns:
            lost = max(lost, furthest - tick.tip[0])
            furthest = max(furthest, tick.tip[0])
    return {
        "approach_mps": approach,
        "brake_late_ms": late_ns / 1e6,
        "coasting_mps": coasting,
        "lost_m": lost,
        "out_m": furthest,
    }


def _straight_out(tick: Tick) -> bool:
    ux, uy, uz = tick.tip_command
    return ux >= -1e-12 and math.hypot(uy, uz) <= 1e-12


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 6)
    return [round(v, 6) for v in value] if isinstance(value, list) else value
