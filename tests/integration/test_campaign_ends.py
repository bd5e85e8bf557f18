"""A campaign that is broken off leaves no process behind, whoever breaks it off."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from contact_sim.campaign.run import read_table

FLIGHTS = 200
"""Hours of flying: none of these tests waits for them."""
PATIENCE_S = 120.0


def _campaign(out: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "contact_sim", "campaign", "--flights", str(FLIGHTS)]
    return subprocess.Popen(
        [*command, "--world", "tunnel", "--jobs", "2", "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def _first_row(out: Path, campaign: subprocess.Popen[str]) -> None:
    """Wait until a flight is over: then its processes fly, and more are planned."""
    table = out / "flights.csv"
    give_up = time.monotonic() + PATIENCE_S
    while not (table.exists() and len(table.read_text().splitlines()) > 1):
        assert campaign.poll() is None, campaign.communicate()[0]
        assert time.monotonic() < give_up, "no flight has ended"
        time.sleep(0.1)


def _session(leader: int) -> list[int]:
    """Processes of a session that run."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        state, session = fields[0], int(fields[3])
        if session == leader and state != "Z":
            found.append(int(folder.name))
    return found


@pytest.mark.parametrize(
    ("send", "sign", "code"),
    [
        (os.kill, signal.SIGINT, 130),
        (os.kill, signal.SIGTERM, 130),
        (os.kill, signal.SIGKILL, -signal.SIGKILL),
        (os.killpg, signal.SIGINT, 130),  # a Ctrl-C on a terminal reaches every process
    ],
)
def test_nothing_flies_on(
    tmp_path: Path, send: Callable[[int, int], None], sign: signal.Signals, code: int
):
    """Interrupted, ended or killed: its processes end in mid-flight, and its rows are whole."""
    campaign = _campaign(tmp_path)
    try:
        _first_row(tmp_path, campaign)
        assert len(_session(campaign.pid)) >= 3
        send(campaign.pid, sign)
        said = campaign.communicate(timeout=PATIENCE_S)[0]
        give_up = time.monotonic() + PATIENCE_S
        while _session(campaign.pid):
            assert time.monotonic() < give_up, "processes of the campaign are left"
            time.sleep(0.05)
    finally:
        for number in _session(campaign.pid):
            os.kill(number, signal.SIGKILL)
    assert campaign.returncode == code
    assert "Traceback" not in said
    rows = read_table(tmp_path / "flights.csv")
    assert 1 <= len(rows) < FLIGHTS / 10
    assert not any(row.error for row in rows)
