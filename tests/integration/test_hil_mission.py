"""A whole mission by ``drone-client fly --sim tunnel --hil``: to contact and back, in OFFBOARD.

Four processes: the client with its world, the service that looks at its pictures, and the stand-in
that estimates and turns the motors; a person who says yes sits at a terminal. Client and service
are the real commands on a clock that waits for whoever is late (``px4_hil_clock``), so that a busy
machine makes the test slower and the flight no other.
"""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import pytest

from tests.integration.px4_hil_clock import SharedTime
from tests.service_process import ServiceProcess, free_port, free_udp_port

CLOCK = Path(__file__).with_name("px4_hil_clock.py")
VEHICLE = Path(__file__).with_name("px4_hil_vehicle.py")
GIVE_UP_S = 240.0
SEED = 3
ON_THE_GROUND = 250
"""Questions before the stand-in arms."""
pytestmark = pytest.mark.timeout(900)
"""All of it is one flight, and a busy machine may take many times as long."""


class Service(ServiceProcess):
    """The service, on the clock of the flight."""

    def __init__(self, folder: Path, clock: Path) -> None:
        super().__init__(folder)
        self._clock = clock

    def start(self) -> None:
        command = [sys.executable, str(CLOCK), str(self._clock), "service", "serve"]
        options = ["--listen", self.endpoint, "--http", self.http, "--name", self.name]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [*command, *options], stdout=log, stderr=log, env=self._env
            )


@contextmanager
def process(*command: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """It is gone afterwards, and whatever it has started."""
    running = subprocess.Popen(command, text=True, start_new_session=True, **options)
    try:
        yield running
    finally:
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
        running.wait()
        if running.stdout is not None:
            running.stdout.close()


@dataclass
class Flown:
    """A mission that is over."""

    codes: dict[str, int]
    """Of client, service and stand-in."""
    leftovers: list[str]
    """Whose group has a process left, seconds later."""
    summary: dict[str, Any]
    vehicle: dict[str, Any]
    """What the stand-in reports."""
    heights_m: list[float]
    """Of the drone, from the ground at its start."""
    told: str


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    folder = tmp_path_factory.mktemp("mission")
    clock, run, log = folder / "clock", folder / "run", folder / "client.log"
    SharedTime.create(clock)
    tcp, udp = f"127.0.0.1:{free_port()}", f"127.0.0.1:{free_udp_port()}"
    with ExitStack() as stack:
        service = Service(folder, clock)
        stack.callback(service.close)
        service.start()
        service.wait_ready()
        person, terminal = pty.openpty()
        stack.callback(os.close, person)
        stack.callback(os.close, terminal)
        told = stack.enter_context(log.open("w"))
        client = stack.enter_context(
            process(
                *(sys.executable, str(CLOCK), str(clock), "client", "fly"),
                *("--sim", "tunnel", "--seed", str(SEED), "--connect", service.endpoint),
                *("--hil", tcp, "--autopilot", f"udp/{udp}", "--out", str(run), "--no-plot"),
                stdin=terminal,
                stdout=told,
                stderr=told,
            )
        )
        vehicle = stack.enter_context(
            process(
                *(sys.executable, str(VEHICLE), "--connect", tcp, "--udp", udp),
                stdout=subprocess.PIPE,
            )
        )
        assert vehicle.stdout is not None
        assert next_line(vehicle.stdout) == "hovers\n", log.read_text()
        os.write(person, b"yes\n")
        codes = {"client": client.wait(GIVE_UP_S)}
        said, _ = vehicle.communicate(timeout=GIVE_UP_S)
        codes |= {"vehicle": vehicle.returncode, "service": service.stop()}
        leftovers = [
            name
            for name, group in (("client", client.pid), ("vehicle", vehicle.pid))
            if outlives(group)
        ]
    rows = [json.loads(line) for line in (run / "truth.jsonl").read_text().splitlines()]
    heights_m = [row["world_from_body"][2] for row in rows]
    return Flown(
        codes,
        leftovers,
        json.loads((run / "summary.json").read_text()),
        json.loads(said.splitlines()[-1]),
        [height_m - heights_m[0] for height_m in heights_m],
        log.read_text(),
    )


def next_line(stream: IO[str]) -> str:
    """Empty: it has ended, or said nothing for too long."""
    ready, _, _ = select.select([stream], [], [], GIVE_UP_S)
    return stream.readline() if ready else ""


def outlives(leader: int) -> bool:
    """Whether the group of a process that has ended is still there after a while."""
    for _ in range(100):
        try:
            os.killpg(leader, 0)
        except ProcessLookupError:
            return False
        time.sleep(0.1)  # what a process has started may end a moment after it
    return True


def test_the_mission_comes_to_contact_and_back(flown: Flown) -> None:
    """Every phase by its own reason, in one approach, and the client says so by its exit code."""
    assert flown.summary["phase"] == "done", flown.told
    assert flown.summary["attempts"] == 1
    for change in (
        "hold -> search",
        "search -> align",
        "align -> approach",
        "approach -> contact",
        "contact -> retreat",
        "retreat -> done",
    ):
        assert change in flown.told


def test_the_tip_alone_touched_and_within_two_centimetres(flown: Flown) -> None:
    """By the truth; the ground on which it stood before it took off does not count."""
    truly = flown.summary["simulated"]
    assert truly["touched"]
    assert truly["offset_m"] < 0.02
    assert truly["outside_m"] == 0.0
    assert truly["pressed_s"] > 1.0
    assert truly["collisions"] == []
    risen = next(i for i, height_m in enumerate(flown.heights_m) if height_m > 0.5)
    assert min(flown.heights_m[risen:]) > 0.5


def test_the_vehicle_is_given_back_clear_of_the_board(flown: Flown) -> None:
    """In LOITER, which it holds; it was taken once, and no rule of the line was broken."""
    assert flown.summary["simulated"]["end_m"] > 0.5
    assert flown.vehicle["mode"] == "AUTO.LOITER"
    assert [change[1:] for change in flown.vehicle["mode_changes"]] == [
        ["OFFBOARD", "command"],
        ["AUTO.LOITER", "command"],
    ]
    assert flown.vehicle["violations"] == []


def test_the_motors_were_turned_by_answers_alone(flown: Flown) -> None:
    """Each HIL_SENSOR had its answer; late is one on the ground alone, where it is not waited for.

    The last one may be on its way at the end.
    """
    truly = flown.summary["simulated"]
    assert truly["error"] is None
    counts = truly["hil"]
    assert counts["asked"] - counts["controls"] <= 1
    assert counts.get("unanswered", 0) < ON_THE_GROUND
    assert set(counts) <= {
        *("asked", "answered", "unanswered", "late"),
        *("heartbeats", "commands", "controls"),
    }


def test_all_processes_end_by_themselves(flown: Flown) -> None:
    """With exit code 0, and with nobody left behind."""
    assert flown.codes == {"client": 0, "vehicle": 0, "service": 0}
    assert flown.leftovers == []
