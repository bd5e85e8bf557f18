"""How punctual the control loop is beside everything else that a drone does.

    scripts/bench tick --minutes 10 --write docs/results/tick.md

A real service process and a real client share this machine's cores: the recording is decoded and
played in a loop as a camera of 15 Hz, frames are coded and go over Zenoh, results come back, and
the control loop ticks at 50 Hz on a mission. Lateness is the time from when a tick was due to when
it began. Rounds with what the client does for punctuality (``drone_client/promptness.py``) take
turns with rounds without it, so that both meet the same machine.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from rich.console import Console
from rich.progress import Progress

from drone_client import control_loop
from drone_client.airframe import Airframe
from drone_client.autopilot.memory import MemoryAutopilot
from drone_client.flight import Flight
from drone_client.flight_settings import flight_settings
from drone_client.ledger import Ledger
from drone_client.link.choose import open_link
from drone_client.link.waiting import wait_for_worker
from drone_client.playback import RealTime
from drone_client.promptness import SWITCH_INTERVAL_S
from drone_client.run_files import TICKS_NAME
from drone_client.settings import ClientSettings
from drone_client.source import Capture
from drone_client.source.replay import ReplaySource, open_recording
from drone_client.summary import read_lines
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose
from tests.perf.bench_detector_table import machine
from tests.service_process import service_process

RECORDING = Path(__file__).parents[2] / "examples/recordings/rendered-approach"
GOAL_P99_MS, GOAL_MAX_MS = 2.0, 20.0
FRAME_NS = 66_666_667
PYTHONS_INTERVAL_S = 0.005


class Looped:
    """A recording from the start again and again, one picture every 67 ms."""

    def __init__(self, source: ReplaySource) -> None:
        self.camera = source.camera
        self._source = source
        self._stamps = [c.t_source_ns for c in source.captures()]

    def __len__(self) -> int:
        return len(self._stamps)

    def captures(self) -> Iterator[Capture]:
        """Without end; every picture is read from disk and decoded anew."""
        number = 0
        while True:
            for capture in self._source.captures():
                yield replace(capture, t_source_ns=number * FRAME_NS)
                number += 1

    def world_from_camera(self, t_source_ns: int) -> Pose | None:
        """That of the picture shown at the time."""
        number = t_source_ns // FRAME_NS % len(self._stamps)
        return self._source.world_from_camera(self._stamps[number])


def fly(endpoint: str, folder: Path, seconds: float, prompt: bool) -> np.ndarray:
    """Lateness [ms] of each tick of one round, without the first second."""
    clock, airframe = MonotonicClock(), Airframe()
    settings = ClientSettings(connect=endpoint, name="drone", wait_for_worker_s=30)
    stop = threading.Event()
    playback = RealTime(Looped(open_recording(RECORDING, None)), airframe, clock, stop)
    ledger = Ledger(folder, overwrite=True)
    sys.setswitchinterval(SWITCH_INTERVAL_S if prompt else PYTHONS_INTERVAL_S)
    first = control_loop.first_in_line if prompt else lambda: False
    with mock.patch.object(control_loop, "first_in_line", first):
        flight = Flight(
            flight_settings(settings),
            airframe,
            open_link(settings, clock),
            MemoryAutopilot(),
            clock,
            ledger,
            playback.world_from_body,
        )
        flight.start()
    try:
        wait_for_worker(flight._link, settings)
        end_ns = clock.now_ns() + round(seconds * 1e9)
        for t_capture_ns, capture in playback.captures():
            if clock.now_ns() > end_ns:
                break
            pose = playback.world_from_body(t_capture_ns)
            frame = RgbdFrame(
                color_rgb=capture.color_rgb,
                depth_units=capture.depth_units,
                camera=playback._source.camera,
                t_capture_ns=t_capture_ns,
                world_from_camera=None if pose is None else pose @ airframe.body_from_camera,
            )
            flight.capture(frame, capture.name)
    finally:
        stop.set()
        flight.stop()
    answered = flight.tally.verdicts["accepted"]
    late_us = [line["late_us"] for line in read_lines(folder / TICKS_NAME)]
    print(
        f"{'prompt' if prompt else 'plain':7} {len(late_us)} ticks, {answered} results accepted",
        file=sys.stderr,
    )
    return np.array(late_us[50:]) / 1e3


def figures(late_ms: np.ndarray) -> dict[str, float]:
    """Lateness of many ticks."""
    p50, p99, p999 = np.quantile(late_ms, [0.5, 0.99, 0.999]).tolist()
    return {
        "ticks": len(late_ms),
        "p50_ms": p50,
        "p99_ms": p99,
        "p999_ms": p999,
        "max_ms": float(late_ms.max()),
        "over_20_ms": int((late_ms > GOAL_MAX_MS).sum()),
    }


def measure(minutes: float, rounds: int) -> dict[str, Any]:
    """Rounds by turns: of six, five with what the client does, one without."""
    seconds = minutes * 60 / rounds
    late: dict[bool, list[np.ndarray]] = {True: [], False: []}
    with tempfile.TemporaryDirectory() as scratch, service_process(Path(scratch)) as service:
        console = Console(stderr=True)
        with Progress(console=console, disable=not console.is_terminal) as bar:
            task = bar.add_task("ticking", total=2 * rounds)
            for n in range(rounds):
                for prompt in (True, False) if n % 2 else (False, True):
                    length = seconds if prompt else min(seconds, 30.0)
                    late[prompt].append(
                        fly(service.endpoint, Path(scratch) / "run", length, prompt)
                    )
                    bar.advance(task)
    return {
        "machine": machine(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0],
        "first_in_line": control_loop.first_in_line(),
        "with": figures(np.concatenate(late[True])),
        "without": figures(np.concatenate(late[False])),
        "p99_by_round_ms": [float(np.quantile(x, 0.99)) for x in late[True]],
    }


def page(result: dict[str, Any], command: str) -> str:
    """The result as Markdown."""
    w, o = result["with"], result["without"]
    lines = [
        "# How punctual the control loop is",
        "",
        f"Made by `{command}` on {result['machine']}. The service, the client and its camera share",
        f"{result['cores']} cores: 15 pictures a second are decoded, coded, sent over Zenoh,",
        "detected and localised; control ticks at 50 Hz. Lateness: from when one was due to when",
        "it began.",
        "",
        "| | goal | as it flies | without `promptness.py` |",
        "| --- | --- | ---: | ---: |",
    ]
    for name, goal, key in (
        ("ticks", "", "ticks"),
        ("p50 [ms]", "", "p50_ms"),
        ("p99 [ms]", f"<= {GOAL_P99_MS:g}", "p99_ms"),
        ("p99.9 [ms]", "", "p999_ms"),
        ("worst [ms]", f"<= {GOAL_MAX_MS:g}", "max_ms"),
        (f"over {GOAL_MAX_MS:g} ms", "0", "over_20_ms"),
    ):
        cells = (
            f"{v[key]:.2f}" if key.endswith("_ms") and key != "over_20_ms" else str(v[key])
            for v in (w, o)
        )
        lines.append(f"| {name} | {goal} | {' | '.join(cells)} |")
    rounds = ", ".join(f"{v:.2f}" for v in result["p99_by_round_ms"])
    fifo = "given" if result["first_in_line"] else "refused by this system"
    lines += ["", f"p99 by round [ms]: {rounds}. Real-time priority: {fifo}."]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure, print, and write what was asked for."""
    parser = argparse.ArgumentParser(
        prog="scripts/bench tick",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="as it flies, in all")
    parser.add_argument("--rounds", type=int, default=5, help="of each kind")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--write", type=Path, help="write the page to this Markdown file, too")
    options = parser.parse_args()
    result = measure(options.minutes, options.rounds)
    text = page(result, f"scripts/bench {shlex.join(['tick', *sys.argv[1:]])}")
    if options.write:
        part = options.write.with_name(f".{options.write.name}.part")
        part.write_text(text, encoding="utf-8")
        os.replace(part, options.write)
    print(json.dumps(result, indent=2) if options.json else text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
