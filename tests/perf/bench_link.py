"""How old frames are when they arrive over a bad link: ours beside what one would use instead.

    scripts/bench link [--quick] [--seconds 2.5] [--repeats 2] [--only A,C] [--contenders udp,tcp]
                       [--json] [--write docs/results/link.md]

Sender and receiver are processes in two network namespaces with the link emulator between them
(needs root); one machine, one clock, so the age of a frame at its arrival, counted from its
capture, is exact. The baselines send each frame at its time: bare UDP in datagrams of 1200 bytes,
one TCP connection, a Zenoh publisher that drops and one that blocks. Ours are the drone's real
uplink over its two links, and the worker's real transports with an immediate answer. Every figure
is the median over the repeats, with the range behind it. A run whose relay was later than 0.3 ms
at p99 is marked with *.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from link_emulator import EmulatorError, Impairments, Namespaces, may_make_namespaces
from rgbd_wire.tunnel.keys import generate_key
from tests.certificates import make_ends
from tests.perf.bench_link_ends import DRONE, WORKER, Arrivals, Job

WARM_UP_S = 1.0
"""Left out: connections start slowly, and the uplink learns what the link carries."""
DRAIN_S = 0.5
START_S, END_S = 15.0, 30.0
PORT = 7447
QUEUE_MS = 100.0
NO_TCP = ""
MS = 1e6
FAILURES = (RuntimeError, subprocess.TimeoutExpired, EmulatorError)
PIPES: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
CONGESTIONS = Path("/proc/sys/net/ipv4/tcp_available_congestion_control")
DEFAULT_CONGESTION = Path("/proc/sys/net/ipv4/tcp_congestion_control")


@dataclass(frozen=True, slots=True)
class Scenario:
    """A link, and what is sent over it."""

    name: str
    title: str
    size_bytes: int
    rate_hz: float
    link: Impairments
    window: int


@dataclass(frozen=True, slots=True)
class Contender:
    """Who carries the frames."""

    name: str
    title: str
    on_tcp: bool


def _radio(**loss: float) -> Impairments:
    return Impairments(rate_mbit=50, delay_ms=10, queue_ms=QUEUE_MS, **loss)


SCENARIOS = (
    Scenario(
        "A",
        "100 kB at 30 fps into 20 Mbit/s, 5 ms",
        100_000,
        30,
        Impairments(rate_mbit=20, delay_ms=5, queue_ms=QUEUE_MS),
        window=2,
    ),
    Scenario("B0", "60 kB at 30 Hz, 50 Mbit/s, 10 ms, clean", 60_000, 30, _radio(), 2),
    Scenario("B1", "60 kB at 30 Hz, 50 Mbit/s, 10 ms, 1 % loss", 60_000, 30, _radio(loss=0.01), 2),
    Scenario(
        "B3",
        "60 kB at 30 Hz, 50 Mbit/s, 10 ms, 3 % loss in bursts of 4",
        60_000,
        30,
        _radio(loss=0.03, burst=4),
        2,
    ),
    Scenario(
        "C",
        "60 kB at 30 Hz into 8 Mbit/s, 10 ms, W = 1",
        60_000,
        30,
        Impairments(rate_mbit=8, delay_ms=10, queue_ms=QUEUE_MS),
        window=1,
    ),
)
CONTENDERS = (
    Contender("udp", "bare UDP", on_tcp=False),
    Contender("tcp", "raw TCP", on_tcp=True),
    Contender("zenoh-drop", "plain Zenoh DROP", on_tcp=True),
    Contender("zenoh-block", "plain Zenoh BLOCK", on_tcp=True),
    Contender("our-zenoh", "**our Zenoh link**", on_tcp=True),
    Contender("our-tunnel", "**our UDP tunnel**", on_tcp=False),
)
ROUND_TRIPS = {
    "tcp": "raw TCP",
    "our-zenoh-tls": "our Zenoh link, tls",
    "our-tunnel": "**our UDP tunnel**, sealed, with parity",
}


# ---- runs


@dataclass(frozen=True, slots=True)
class Run:
    """What came of one run."""

    captured: int
    seconds: float
    ages_ms: tuple[float, ...]
    release_p99_ms: float
    release_max_ms: float
    marked: bool
    sent: int

    def age(self, quantile: float) -> float:
        """Of what arrived; no number if nothing did."""
        return float(np.quantile(self.ages_ms, quantile)) if self.ages_ms else float("nan")

    def within(self, limit_ms: float) -> float:
        """Share of the captured frames that arrived no older than this."""
        return sum(age <= limit_ms for age in self.ages_ms) / self.captured

    @property
    def fps(self) -> float:
        """Frames that arrived in a second."""
        return len(self.ages_ms) / self.seconds


@contextmanager
def receiving(process: subprocess.Popen[str]) -> Iterator[list[Any]]:
    """A receiving end that is ready; the list holds what it got after the block."""
    assert process.stdout is not None
    out: list[Any] = []
    try:
        if process.stdout.readline() != "ready\n":
            raise RuntimeError("the receiving end did not start; its words stand above")
        yield out
        text, _ = process.communicate(timeout=END_S)
        out.extend(json.loads(text))
    finally:
        process.kill()
        process.communicate()


def measure(
    scenario: Scenario,
    contender: Contender,
    congestion: str,
    seconds: float,
    seed: int,
    folder: Path,
) -> Run:
    """One run in namespaces of its own."""
    job = Job(
        "receive",
        contender.name,
        Namespaces.address_b,
        PORT,
        scenario.size_bytes,
        scenario.rate_hz,
        WARM_UP_S + seconds,
        scenario.window,
        str(folder),
    )
    with Namespaces(scenario.link, seed=seed) as net:
        if contender.on_tcp:
            net.congestion_control("a", congestion)
        receiver = net.popen("b", command(job), **PIPES)
        sender = net.popen("a", command(replace(job, role="send")), **PIPES)  # both load at once
        with receiving(receiver) as arrivals:
            net.control.reset()
            numbers = sent_by(sender, contender, START_S + job.seconds)
            time.sleep(DRAIN_S)
            report = net.control.report()
    first = round(WARM_UP_S * scenario.rate_hz)
    last = round(job.seconds * scenario.rate_hz)
    return Run(
        last - first,
        seconds,
        ages_ms(arrivals, first),
        report.release_error_p99_ms,
        report.release_error_max_ms,
        report.marked,
        sum(number >= first for number in numbers | {n for n, *_ in arrivals}),
    )


def sent_by(sender: subprocess.Popen[str], contender: Contender, limit_s: float) -> set[int]:
    """Let it send; numbers of the frames that it sent."""
    try:
        told, _ = sender.communicate("go\n", timeout=limit_s)
    except subprocess.TimeoutExpired:
        note(f"{contender.name} was still blocked after {limit_s:g} s")
        return set()
    if sender.returncode:
        raise RuntimeError(f"{contender.name} could not send; its words stand above")
    return set(json.loads(told))


def ages_ms(arrivals: Arrivals, first: int) -> tuple[float, ...]:
    """Ages at arrival of the frames from a number on."""
    return tuple((here - captured) / MS for number, captured, here in arrivals if number >= first)


def measure_round_trip(contender: str, seconds: float, folder: Path) -> list[float]:
    """Round trips [ms] on the loopback of one namespace, where nobody else is; no emulator."""
    job = Job("answer", contender, "127.0.0.1", PORT, 60_000, 30, seconds, 1, str(folder))
    with Namespaces() as net:
        answerer = net.popen("b", command(job), **PIPES)
        asker = net.popen("b", command(replace(job, role="ask")), **PIPES)
        with receiving(answerer):
            told, _ = asker.communicate("go\n", timeout=START_S + seconds)
    if asker.returncode:
        raise RuntimeError(f"{contender} could not ask; its words stand above")
    times: list[float] = json.loads(told)
    return times[len(times) // 10 :]


def command(job: Job) -> list[str]:
    """Of one end."""
    return [sys.executable, "-m", "tests.perf.bench_link_ends", job.as_argument()]


# ---- tables


def spread(values: Sequence[float], digits: int = 0) -> str:
    """Median, and the range where there is one."""
    if np.isnan(values).any():
        return "-"
    low, middle, high = (f"{v:.{digits}f}" for v in np.quantile(values, [0, 0.5, 1]))
    return middle if low == high else f"{middle} ({low}-{high})"


def middle(runs: Sequence[Run], figure: Callable[[Run], float]) -> float:
    """Median over the repeats."""
    return float(np.median([figure(run) for run in runs]))


Key = tuple[str, str]
"""Contender and congestion control."""


def table(scenario: Scenario, runs: dict[Key, list[Run]], clean: dict[Key, list[Run]]) -> str:
    """Markdown, a line for each contender."""
    lossy = bool(clean) and scenario.name in ("B1", "B3")
    head = ["", "TCP", "age p50 [ms]", "p95", "p99", "fps", "sent", "delivered", "within 50 ms"]
    head += ["within 100 ms"] + (["within 1.5 x clean p99"] if lossy else [])
    lines = [f"| {' | '.join(head)} |", "| --- " * len(head) + "|"]
    titles = {c.name: c for c in CONTENDERS}
    for (name, congestion), mine in runs.items():
        cells = [titles[name].title, congestion]
        cells += [spread([r.age(q) for r in mine]) for q in (0.5, 0.95, 0.99)]
        cells += [spread([r.fps for r in mine], 1)]
        shares = [
            lambda r: r.sent / r.captured,
            lambda r: len(r.ages_ms) / r.captured,
            within(50),
            within(100),
        ]
        if lossy and (name, congestion) in clean:
            shares.append(within(1.5 * middle(clean[name, congestion], lambda r: r.age(0.99))))
        cells += [f"{spread([100 * share(r) for r in mine], 1)} %" for share in shares]
        if any(r.marked for r in mine):
            cells[0] += f" * ({max(r.release_p99_ms for r in mine):.2f} ms)"
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def within(limit_ms: float) -> Callable[[Run], float]:
    """Share of what was captured."""
    return lambda run: run.within(limit_ms)


def floor_ms(scenario: Scenario) -> float:
    """Serialisation of a frame and the round trip [ms]."""
    rate = scenario.link.rate_mbit
    assert rate is not None
    return scenario.size_bytes * 8e-3 / rate + 2 * scenario.link.delay_ms


def verdicts(
    scenario: Scenario, runs: dict[Key, list[Run]], clean: dict[Key, list[Run]]
) -> list[str]:
    """What our goals ask of our two, met or not, one line each."""
    lines = []
    for (name, congestion), mine in runs.items():
        if not name.startswith("our-"):
            continue
        who = f"{name}{f' ({congestion})' if name == 'our-zenoh' else ''}"
        if scenario.name == "A":
            p95, fps = middle(mine, lambda r: r.age(0.95)), middle(mine, lambda r: r.fps)
            lines.append(
                f"{who}: p95 {p95:.0f} ms at {fps:.1f} fps, goal <= 90 ms at >= 23 fps: "
                + met(p95 <= 90 and fps >= 23)
            )
        elif scenario.name == "C":
            p99, limit = middle(mine, lambda r: r.age(0.99)), 2 * floor_ms(scenario)
            lines.append(
                f"{who}: p99 {p99:.0f} ms, goal <= 2 x (serialisation + RTT) = {limit:.0f} ms: "
                + met(p99 <= limit)
            )
        elif scenario.name == "B1" and name == "our-tunnel" and (name, congestion) in clean:
            limit = 1.5 * middle(clean[name, congestion], lambda r: r.age(0.99))
            share = middle(mine, within(limit))
            lines.append(
                f"{who}: {100 * share:.1f} % within {limit:.0f} ms (1.5 x clean p99), "
                f"goal >= 99 %: {met(share >= 0.99)}"
            )
        elif scenario.name == "B3" and name == "our-tunnel":
            share = middle(mine, within(50))
            oldest = middle(mine, lambda r: r.age(1))
            lines.append(
                f"{who}: {100 * share:.1f} % within 50 ms and the oldest {oldest:.0f} ms, "
                f"goal >= 97 % and 100 ms: {met(share >= 0.97 and oldest <= 100)}"
            )
    return lines


def met(is_met: bool) -> str:
    """In a word."""
    return "met" if is_met else "**missed**"


def round_trip_table(trips: dict[str, list[list[float]]]) -> str:
    """Markdown, and the goal."""
    lines = ["| | p50 [ms] | p95 | p99 | p50 / raw TCP |", "| --- | --- | --- | --- | --- |"]
    p50 = {name: float(np.median([np.median(t) for t in mine])) for name, mine in trips.items()}
    for name, mine in trips.items():
        cells = [spread([float(np.quantile(t, q)) for t in mine], 2) for q in (0.5, 0.95, 0.99)]
        ratio = f"{p50[name] / p50['tcp']:.1f}" if "tcp" in p50 else "-"
        lines.append(f"| {ROUND_TRIPS[name]} | {' | '.join(cells)} | {ratio} |")
    if set(p50) == set(ROUND_TRIPS):
        ratio = p50["our-tunnel"] / p50["tcp"]
        is_met = ratio <= 4 and p50["our-tunnel"] < p50["our-zenoh-tls"]
        lines += [
            "",
            f"- our-tunnel: {ratio:.1f} x raw TCP, goal <= 4 x and below Zenoh tls: {met(is_met)}",
        ]
    return "\n".join(lines)


def machine() -> str:
    """What the figures depend on, in a sentence."""
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    return (
        f"{os.cpu_count()} cores{f' ({model[1]})' if model else ''}, "
        f"Linux {platform.release().split('-')[0]}, Python {platform.python_version()}, "
        f"Zenoh {version('eclipse-zenoh')}; TCP congestion control: default "
        f"{DEFAULT_CONGESTION.read_text().strip()}, available {CONGESTIONS.read_text().strip()}"
    )


# ---- the command


def runs_of(
    contenders: Sequence[Contender], congestions: Sequence[str]
) -> list[tuple[Contender, str]]:
    """Who runs with which congestion control."""
    return [(who, c) for who in contenders for c in (congestions if who.on_tcp else [NO_TCP])]


def bench(args: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """All runs, repeat by repeat, so that a busy minute of the machine hits all alike."""
    available = CONGESTIONS.read_text().split()
    congestions = [c for c in ("cubic", "bbr") if c in available]
    if args.quick:
        congestions = congestions[:1]
    if len(congestions) < 2:
        note(f"TCP with {', '.join(congestions)} alone")
    contenders = [c for c in CONTENDERS if not args.contenders or c.name in args.contenders]
    wanted = [s for s in SCENARIOS if not args.only or s.name in args.only]
    runs: dict[str, dict[Key, list[Run]]] = {s.name: {} for s in wanted}
    trips: dict[str, list[list[float]]] = {}
    for repeat in range(args.repeats):
        for scenario in wanted:
            for contender, congestion in runs_of(contenders, congestions):
                try:
                    run = measure(scenario, contender, congestion, args.seconds, repeat, folder)
                except FAILURES as error:  # one that failed is missing; ten minutes are not lost
                    note(f"{scenario.name} {contender.name} {congestion}: {error}")
                    continue
                runs[scenario.name].setdefault((contender.name, congestion), []).append(run)
                note(
                    f"{repeat + 1}/{args.repeats} {scenario.name} {contender.name} {congestion}: "
                    f"p50 {run.age(0.5):.0f} p95 {run.age(0.95):.0f} ms, {run.fps:.1f} fps, "
                    f"relay p99 {run.release_p99_ms:.2f} ms{' MARKED' if run.marked else ''}"
                )
        if not args.only or "D" in args.only:
            for name in ROUND_TRIPS:
                try:
                    times = measure_round_trip(name, args.seconds, folder)
                except FAILURES as error:
                    note(f"D {name}: {error}")
                    continue
                trips.setdefault(name, []).append(times)
                note(f"{repeat + 1}/{args.repeats} D {name}: p50 {np.median(times):.2f} ms")
    return {"runs": runs, "trips": trips}


def note(text: str) -> None:
    """Progress."""
    print(text, file=sys.stderr, flush=True)


def render(measured: dict[str, Any]) -> str:
    """Markdown of everything."""
    runs = measured["runs"]
    clean = runs.get("B0", {})
    parts = []
    for scenario in SCENARIOS:
        mine = runs.get(scenario.name)
        if mine:
            goals = "\n".join(f"- {line}" for line in verdicts(scenario, mine, clean))
            parts.append(f"## {scenario.name}: {scenario.title}\n\n{table(scenario, mine, clean)}")
            parts += [goals] if goals else []
    if measured["trips"]:
        parts.append(
            "## D: round trip on loopback, 60 kB up and an ack down, paced at 30 Hz\n\n"
            + round_trip_table(measured["trips"])
        )
    return "\n\n".join(parts)


def as_json(measured: dict[str, Any]) -> str:
    """All figures of all runs."""
    rows = [
        {
            "scenario": scenario,
            "contender": contender,
            "congestion": congestion,
            "age_ms": {f"p{round(100 * q)}": run.age(q) for q in (0.5, 0.95, 0.99, 1)},
            "fps": run.fps,
            "delivered": len(run.ages_ms) / run.captured,
            "within_50_ms": run.within(50),
            "within_100_ms": run.within(100),
            "release_p99_ms": run.release_p99_ms,
            "release_max_ms": run.release_max_ms,
            "marked": run.marked,
            "sent": run.sent / run.captured,
        }
        for scenario, by_key in measured["runs"].items()
        for (contender, congestion), mine in by_key.items()
        for run in mine
    ]
    return json.dumps({"machine": machine(), "runs": rows, "round_trips_ms": measured["trips"]})


def document(args: argparse.Namespace, text: str) -> str:
    """docs/results/link.md."""
    shown = " ".join(["scripts/bench link", *sys.argv[1:]])
    return f"""# Frames over a bad link

Made by `{shown}` on {machine()}.

Age is from capture to the last byte at the worker, of what arrived; shares are of what was
captured. Frames of {WARM_UP_S:g} s are left out at the start, {args.seconds:g} s count; runs of
each: {args.repeats}, their median stands here with the range in brackets. The queue in front of
the emulated rate holds {QUEUE_MS:g} ms; rate and loss hold in both directions. * marks runs in
which the emulator was later than 0.3 ms at p99 (the worst in brackets): their times are not to be
trusted. Baselines send each frame at its time (bare UDP: 1200-byte datagrams, no parity, all at
once; plain Zenoh: one put a frame, no ack clock). Ours are the drone's uplink and the worker's
transports as they fly.

{text}
"""


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    listed: Callable[[str], list[str]] = lambda text: text.split(",")  # noqa: E731
    names = ", ".join([*(s.name for s in SCENARIOS), "D"])
    parser.add_argument("--only", type=listed, help=f"scenarios, of {names}")
    parser.add_argument(
        "--contenders", type=listed, help=f"of {', '.join(c.name for c in CONTENDERS)}"
    )
    parser.add_argument("--seconds", type=float, help="of each run (2.5; quick: 0.8)")
    parser.add_argument("--repeats", type=int, help="of everything (2; quick: 1)")
    parser.add_argument("--quick", action="store_true", help="under two minutes, TCP with cubic")
    parser.add_argument("--json", action="store_true", help="all figures of all runs")
    parser.add_argument("--write", type=Path, help="write the tables to a file, too")
    args = parser.parse_args()
    args.seconds = args.seconds or (0.8 if args.quick else 2.5)
    args.repeats = args.repeats or (1 if args.quick else 2)
    why_not = may_make_namespaces()
    if why_not:
        print(f"bench link: {why_not}", file=sys.stderr)
        return 2
    note(machine())
    with tempfile.TemporaryDirectory() as name:
        folder = make_ends(Path(name), (DRONE,), (WORKER,))
        (folder / "drones.keys").write_text(f"{DRONE} {generate_key()}\n")
        (folder / "drones.keys").chmod(0o600)
        measured = bench(args, folder)
    text = render(measured)
    print(as_json(measured) if args.json else text)
    if args.write:
        args.write.write_text(document(args, text))
    return 0


if __name__ == "__main__":
    sys.exit(main())
