"""``drone-client fly --sim`` as its users have it: a real process, its real service, real time.

What is asserted is the truth, which no part of the client knows. A machine that is too slow for
world, client and service at once may abort the flight; then it has to be a safe one, that says why.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.flight_process import FLY, flight_process

FLIGHT_S = 300.0
LATE_SHARE, SLIPPED_S = 0.05, 0.2
"""More late answers than that, or a world that fell so far behind: the machine was too slow."""
VARIABLES = {"DRONE_NAME": "alpha", "DRONE_TLS": "/nowhere", "DRONE_KEY_FILE": "/nowhere"}
"""Of the drone that usually flies from here: it keeps its name, and what is started for the flight
is reached all the same."""
GRAZED_M = 0.002
"""A flight that is aborted for late pictures may have brushed the mouth's edge: less than 1 N."""
pytestmark = pytest.mark.timeout(400)


@dataclass
class Flown:
    """A flight that is over."""

    code: int
    said: str
    summary: dict[str, Any]
    left: dict[int, str]
    files: set[str]

    @property
    def done(self) -> bool:
        return self.summary["phase"] == "done"

    @property
    def late(self) -> bool:
        """Whether answers or the world itself came too late to fly by."""
        verdicts = self.summary["verdicts"]
        late = sum(verdicts.get(name, 0) for name in ("too_old", "network_delay"))
        slipped = self.truly["slipped_s"] > SLIPPED_S
        return slipped or late > LATE_SHARE * sum(verdicts.values())

    @property
    def truly(self) -> dict[str, Any]:
        return self.summary["simulated"]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    folder = tmp_path_factory.mktemp("flight")
    out, log = folder / "run", folder / "log"
    options = "--sim", "tunnel", "--seed", "0", "--link", "wifi", "--json", "--out", str(out)
    with flight_process(*FLY, *options, log=log, variables=VARIABLES) as flight:
        code = flight.process.wait(FLIGHT_S)
        left = flight.left(5.0)
    return Flown(
        code,
        log.read_text(),
        json.loads((out / "summary.json").read_text()),
        left,
        {path.name for path in out.iterdir()},
    )


def test_the_tip_alone_touches_and_nothing_is_pushed_beside_the_mouth(flown: Flown):
    """Whatever became of it: no propeller, no body, no wall, and never beside the mouth."""
    assert flown.truly["error"] is None, flown.said
    assert flown.summary["drone"] == "alpha"
    assert flown.truly["collisions"] == []
    assert flown.truly["outside_m"] <= (0.0 if flown.done else GRAZED_M)


def test_it_comes_to_contact_and_back(flown: Flown):
    """Within 2 cm of the centre, gently; or it has been too slow, and says so."""
    if not flown.done:
        assert flown.code == 3
        assert flown.late, flown.said
        pytest.skip(f"too slow for a flight in real time: {flown.said.splitlines()[-1]}")
    assert flown.code == 0, flown.said
    truly = flown.truly
    assert truly["touched"]
    assert truly["offset_m"] < 0.02
    assert truly["closing_mps"] < 0.2
    assert truly["peak_force_n"] < 6.0
    assert truly["pressed_s"] > 0.5
    assert truly["end_m"] > 0.3
    assert truly["safe"]


def test_it_ends_cleanly(flown: Flown):
    """No process is left, no key; its files are."""
    assert flown.left == {}
    assert "Traceback" not in flown.said
    assert "tunnel.key" not in flown.files
    assert {"ledger.jsonl", "summary.json", "truth.jsonl", "edge-service.log"} <= flown.files


def test_broken_off_it_says_so_and_leaves_nothing(tmp_path: Path):
    """SIGTERM in flight, as a Ctrl-C: it backs off, gives the drone back, and ends with 130."""
    out, log = tmp_path / "run", tmp_path / "log"
    with flight_process(*FLY, "--sim", "tunnel", "--out", str(out), log=log) as flight:
        flight.wait_until(lambda: "hold -> search" in log.read_text())
        os.kill(flight.process.pid, signal.SIGTERM)
        try:
            code = flight.process.wait(120)
        except subprocess.TimeoutExpired:
            pytest.fail(log.read_text())
        assert flight.left(5.0) == {}
    said = log.read_text()
    assert code == 130, said
    assert "abort: backing off" in said
    assert "truth" in said  # the table that is printed without --json
    assert json.loads((out / "summary.json").read_text())["broken_off"]
