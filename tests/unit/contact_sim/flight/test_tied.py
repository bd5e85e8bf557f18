"""A command that is tied to whoever started it: real processes, ended and killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PATIENCE_S = 60.0
TELLS = "import os; print(os.getpid(), flush=True)"
SLEEPS = f"{TELLS}; import time; time.sleep(600)"
DEAF = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {SLEEPS}"
WITH_A_CHILD = (
    f"{TELLS}; import subprocess, sys; "
    f"c = subprocess.Popen([sys.executable, '-c', {DEAF!r}]); c.wait()"
)


def tied(script: str, *, end_s: float = 30.0) -> subprocess.Popen[str]:
    """The script prints its process as soon as it is what it is meant to be."""
    return subprocess.Popen(
        [sys.executable, "-m", "contact_sim.flight.tied", str(end_s), sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def first_number(process: subprocess.Popen[str]) -> int:
    assert process.stdout is not None
    return int(process.stdout.readline())


def lives(number: int) -> bool:
    try:
        stat = Path(f"/proc/{number}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def gone(number: int) -> bool:
    give_up = time.monotonic() + PATIENCE_S
    while lives(number) and time.monotonic() < give_up:
        time.sleep(0.02)
    return not lives(number)


@pytest.mark.parametrize(
    ("script", "end_s", "code"),
    [
        (SLEEPS, 60.0, 128 + signal.SIGTERM),
        (DEAF, 0.2, 128 + signal.SIGKILL),
    ],
)
def test_it_ends_when_its_starter_lets_go(script: str, end_s: float, code: int):
    """Told at first, killed where it does not listen; the exit status says which."""
    with tied(script, end_s=end_s) as process:
        number = first_number(process)
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(PATIENCE_S) == code
        assert gone(number)


def test_it_ends_when_its_starter_is_killed():
    """A process between the two of us starts it, and is killed without a word."""
    starter = (
        "import subprocess, sys, time\n"
        "p = subprocess.Popen([sys.executable, '-m', 'contact_sim.flight.tied', '30', "
        f"sys.executable, '-c', '{SLEEPS}'], "
        "stdin=subprocess.PIPE, start_new_session=True)\n"
        "time.sleep(600)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", starter], stdout=subprocess.PIPE, text=True
    ) as process:
        number = first_number(process)
        assert lives(number)
        process.kill()
        assert gone(number)


def test_what_it_has_started_ends_with_it():
    """Also what does not listen."""
    with tied(WITH_A_CHILD) as process:
        number, child = first_number(process), first_number(process)
        assert process.stdin is not None
        process.stdin.close()
        process.wait(PATIENCE_S)
        assert gone(number)
        assert gone(child)


def test_its_own_end_is_told():
    """With its exit status, and at once; a signal is passed on."""
    with tied(f"{TELLS}; raise SystemExit(7)") as process:
        first_number(process)
        assert process.wait(PATIENCE_S) == 7
    with tied(SLEEPS) as process:
        number = first_number(process)
        os.kill(process.pid, signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 128 + signal.SIGTERM
        assert gone(number)


def test_a_command_that_there_is_not_is_told():
    """In one line."""
    done = subprocess.run(
        [sys.executable, "-m", "contact_sim.flight.tied", "1", "/nowhere/at-all"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 127
    assert done.stderr == "/nowhere/at-all: No such file or directory\n"
