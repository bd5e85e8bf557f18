"""A campaign that is broken off leaves no process behind, whoever breaks it off."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from contact_sim.campaign.run import read_table

FLIGHTS = 200
"""Hours of flying: none of these tests waits for them."""
PATIENCE_S = 120.0


def _campaign(out: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "contact_sim", "campaign", "--flights", str(FLIGHTS)]
    return subprocess.Popen(
        [*command, "--world", "tunnel", "--jobs", "2", "--out", str(out), *options],
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
    "broken_off_by", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=lambda s: s.name
)
def test_nothing_flies_on(tmp_path: Path, broken_off_by: signal.Signals):
    """Interrupted, ended or killed: its processes end in mid-flight, and its rows are whole."""
    campaign = _campaign(tmp_path)
    try:
        _first_row(tmp_path, campaign)
        assert len(_session(campaign.pid)) >= 3
        os.kill(campaign.pid, broken_off_by)
        said = campaign.communicate(timeout=PATIENCE_S)[0]
        give_up = time.monotonic() + PATIENCE_S
        while _session(campaign.pid):
            assert time.monotonic() < give_up, "processes of the campaign are left"
            time.sleep(0.05)
    finally:
        for number in _session(campaign.pid):
            os.kill(number, signal.SIGKILL)
    expected = -signal.SIGKILL if broken_off_by is signal.SIGKILL else 130
    assert campaign.returncode == expected
    assert "Traceback" not in said
    rows = read_table(tmp_path / "flights.csv")
    assert 1 <= len(rows) < FLIGHTS / 10
    assert not any(row.error for row in rows)


def test_a_ctrl_c_on_a_terminal_reaches_every_process(tmp_path: Path):
    """Then, too, it is the campaign that ends it, without a traceback of any process."""
    campaign = _campaign(tmp_path)
    try:
        _first_row(tmp_path, campaign)
        os.killpg(campaign.pid, signal.SIGINT)
        said = campaign.communicate(timeout=PATIENCE_S)[0]
    finally:
        for number in _session(campaign.pid):
            os.kill(number, signal.SIGKILL)
    assert campaign.returncode == 130
    assert "Traceback" not in said
