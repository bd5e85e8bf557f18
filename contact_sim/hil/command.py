"""``python -m contact_sim hil``: the world that a PX4 SITL binary connects to."""

from __future__ import annotations

import json
import math
from collections import deque
from contextlib import closing
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.status import Status
from rich.table import Table
from rich.text import Text

from contact_sim.chance import MAX_SEED
from contact_sim.hil.flight import HilSettings
from contact_sim.hil.ground import on_the_ground
from contact_sim.hil.line import Door, Line, address_of
from contact_sim.hil.lockstep import Patience
from contact_sim.hil.session import INTERRUPTED, FlightReport, Session
from contact_sim.scene import BOARDS, WORLDS, build_scene
from rgbd_wire.clock import Clock, MonotonicClock

EXIT_FAILED: Final = 3
STATUS_NS: Final = 500_000_000
KNOCK_S: Final = 0.5
KEPT_FLIGHTS: Final = 100
"""Whose reports stand in the summary: the newest."""


def hil(
    world: Annotated[str, typer.Option(help=" or ".join(WORLDS))] = "tunnel",
    seed: Annotated[int, typer.Option(min=0, max=MAX_SEED, help="of the world and flight")] = 0,
    board: Annotated[str, typer.Option(help=f"print: {', '.join(BOARDS)}")] = "clean",
    listen: Annotated[
        str, typer.Option(help="HOST:PORT; PX4 calls 127.0.0.1:4560")
    ] = "127.0.0.1:4560",
    gps: Annotated[
        bool,
        typer.Option(
            "--gps/--no-gps", help="HIL_GPS 5 Hz: a home, for a PX4 with its own parameters"
        ),
    ] = True,
    vio: Annotated[
        bool,
        typer.Option(
            "--vio/--no-vio",
            help="ODOMETRY and DISTANCE_SENSOR 50 Hz; not where drone-client sends them",
        ),
    ] = True,
    thrust_curve: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="as PX4's THR_MDL_FAC; 0: linear")
    ] = 0.0,
    speed: Annotated[
        float, typer.Option(min=0.0, max=100.0, help="times real time; 0: as fast as it goes")
    ] = 1.0,
    flights: Annotated[
        int, typer.Option(min=0, max=1_000_000, help="end after so many; 0: at Ctrl-C")
    ] = 0,
    wait_s: Annotated[
        float,
        typer.Option(min=0.001, max=600.0, help="for an answer of a PX4 that flies, then go on"),
    ] = 1.0,
    hung_s: Annotated[
        float, typer.Option(min=0.01, max=3600.0, help="without an answer in flight: it is over")
    ] = 10.0,
    boot_s: Annotated[
        float,
        typer.Option(min=0.01, max=3600.0, help="the same on the ground, booting or disarmed"),
    ] = 120.0,
    as_json: Annotated[bool, typer.Option("--json", help="print the summary as JSON")] = False,
) -> None:
    """Let a PX4 SITL binary fly the simulated drone: lockstep over TCP, as with Gazebo.

    PX4 is the one that connects: start this first, then PX4 without a simulator of its own
    (make px4_sitl none_iris). The drone stands on the ground where the world begins; it is armed
    and taken off by PX4 (commander takeoff), and flown by whoever speaks with PX4. HIL_SENSOR goes
    out 250 times a simulated second, and no step is made before its HIL_ACTUATOR_CONTROLS has come
    back. Each connection is a flight of its own, and begins anew; Ctrl-C ends.

    Parameters and frames: docs/px4.md, "PX4 SITL flies the simulated drone".

    Exit code 0: ended, or interrupted. 3: the last flight ended by a fault.

    Example: python -m contact_sim hil --world tunnel --seed 3

    Example: python -m contact_sim hil --listen 127.0.0.1:4560 --flights 1 --json > flight.json
    """
    host, port = address_of(listen)
    settings = HilSettings(gps=gps, vio=vio, thrust_curve=thrust_curve)
    waits = Patience(armed_s=wait_s, hung_s=hung_s, boot_s=boot_s)
    console = Console(stderr=True)
    clock = MonotonicClock()
    reports: deque[FlightReport] = deque(maxlen=KEPT_FLIGHTS)
    flown = 0
    with closing(Door(host, port)) as door:
        at = f"{door.address[0]}:{door.address[1]}"
        with console.status(f"building the world {world}, seed {seed}") as status:
            show = Show(console, status, door, clock)
            try:
                scene = on_the_ground(build_scene(world, seed, board))
                while flights == 0 or flown < flights:
                    with closing(show.wait(at)) as line:
                        session = Session(line, scene, seed, settings, waits, clock)
                        report = session.fly(speed, show.look)
                    reports.append(report)
                    flown += 1
                    show.tell(report)
                    if report.why == INTERRUPTED:
                        break
            except KeyboardInterrupt:
                pass  # nobody flew
    summary = {
        "world": world,
        "seed": seed,
        "listened": at,
        "flown": flown,
        "turned_away": show.turned_away,
        "flights": [report.as_json() for report in reports],
    }
    if as_json:
        print(json.dumps(summary, indent=2))
    elif reports:
        print_report(reports[-1])
    if reports and reports[-1].failed:
        raise typer.Exit(EXIT_FAILED)


class Show:
    """What the person in charge sees: a line that lives, and a sentence for what happens."""

    def __init__(self, console: Console, status: Status, door: Door, clock: Clock) -> None:
        self.turned_away = 0
        """Who knocked while another flew."""
        self._console = console
        self._status = status
        self._door = door
        self._clock = clock
        self._shown_ns = 0
        self._armed = False

    def wait(self, at: str) -> Line:
        """Until somebody knocks."""
        self._status.update(f"waits for PX4 at {at} (Ctrl-C ends)")
        if not self._console.is_terminal:
            self._say(f"waits for PX4 at {at}")
        while (line := self._door.wait(KNOCK_S)) is None:
            pass
        self._say("somebody connected: the drone stands on the ground")
        self._armed = False
        return line

    def look(self, session: Session) -> None:
        """After a turn."""
        exchange = session.flight.lockstep
        if exchange.armed != self._armed:
            self._armed = exchange.armed
            word = "armed" if self._armed else "disarmed"
            self._say(f"{word} at {session.simulation.t_ns / 1e9:.2f} s")
        now_ns = self._clock.now_ns()
        if now_ns - self._shown_ns < STATUS_NS:
            return
        self._shown_ns = now_ns
        if strangers := self._door.turn_away():
            self.turned_away += strangers
            self._say(f"turned away {strangers} more that wanted to connect: one drone, one PX4")
        self._status.update(status_line(session))

    def tell(self, report: FlightReport) -> None:
        """After a flight."""
        style = "red" if report.failed else None
        self._say(f"the flight is over: {report.why}", style)

    def _say(self, sentence: str, style: str | None = None) -> None:
        self._console.print(sentence, style=style, markup=False, highlight=False, soft_wrap=True)


def status_line(session: Session) -> str:
    """How a flight is, in a line."""
    truth, exchange = session.simulation.truth, session.flight.lockstep
    t_s, took_s = truth.t_ns / 1e9, max(session.took_s, 1e-3)
    x, y, z = truth.world_from_body.translation.tolist()
    how = "armed" if exchange.armed else "disarmed"
    if exchange.newest is None:
        how = "boots, says nothing yet"
    line = (
        f"{t_s:.1f} s ({t_s / took_s:.2f} x)  {how}  "
        f"({x:.2f}, {y:.2f}, {z:.2f}) m  {math.hypot(*truth.velocity_world):.2f} m/s"
    )
    if truth.tip_force_n > 0.0:
        line += f"  tip {truth.tip_force_n:.1f} N"
    missing = exchange.counts["unanswered"]
    return line + (f"  {missing} missed" if missing else "")


def print_report(report: FlightReport) -> None:
    """A table for people."""
    table = Table("", "", show_header=False, title="the last flight")
    for name, value in _rows(report):
        table.add_row(Text(name), Text(value))
    Console().print(table)


def _rows(report: FlightReport) -> list[tuple[str, str]]:
    outcome = report.outcome
    counts = ", ".join(f"{name} {n}" for name, n in report.counts.items())
    touch = "none"
    if outcome.touched and outcome.offset_m is not None:
        touch = f"{outcome.offset_m * 1e3:.0f} mm off, at most {outcome.peak_force_n:.1f} N"
    return [
        ("ended", report.why),
        ("simulated", f"{report.simulated_s:.2f} s in {report.took_s:.2f} s"),
        ("armed", f"{report.armed_s:.2f} s"),
        ("contact", touch),
        ("touched", ", ".join(outcome.collisions) or "nothing"),
        ("exchange", counts),
    ]
