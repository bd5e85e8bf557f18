"""The process around the service: it drains and ends, whatever became of its output."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[3]
TIMEOUT_S = 120
CODE = "from tests.unit.edge_service.served_process import main; main()"


@contextmanager
def serving(load, stdout):
    """A process whose model is loaded as ``load`` says; gone afterwards."""
    # Unbuffered, nothing would be left that Python could fail to write at its end
    env = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    command = [sys.executable, "-c", CODE, load]
    process = subprocess.Popen(
        command, cwd=ROOT, env=env, stdout=stdout, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for(word, process):
    """Read its errors as far as a line with the word."""
    for line in process.stderr:
        if word in line:
            return
    raise AssertionError(f"it never said {word!r}")


def ended(process):
    """Exit code and the errors that were not read yet."""
    err = process.stderr.read()
    return process.wait(TIMEOUT_S), err


def test_a_reader_that_is_gone_does_not_keep_it_from_draining():
    """As ``serve | tee log`` and Ctrl-C, which ends tee first: drained, closed, exit code 0."""
    with serving("at_once", subprocess.PIPE) as process:
        wait_for("announced", process)
        process.stdout.close()
        process.send_signal(signal.SIGTERM)
        code, err = ended(process)
    assert '"message": "drained"' in err
    assert err.splitlines().count("closed") == 1
    assert "Error" not in err
    assert code == 0


def test_a_full_disk_does_not_keep_it_from_serving_and_draining():
    """Nothing that is said can be written from the start, and everything is done all the same."""
    with Path("/dev/full").open("w") as full, serving("at_once", full) as process:
        wait_for("announced", process)
        process.send_signal(signal.SIGTERM)
        code, err = ended(process)
    assert '"message": "drained"' in err
    assert "Error" not in err
    assert code == 0


def test_a_stop_while_the_model_loads_waits_for_nothing():
    """A model that never comes holds no end up, and no drone hears of this worker."""
    with serving("never", subprocess.PIPE) as process:
        wait_for("loading", process)
        process.send_signal(signal.SIGTERM)
        code, err = ended(process)
        out = process.stdout.read()
    assert code == 0
    assert err == ""
    assert "ready " not in out
    assert "bye" in out


def test_a_stop_in_the_last_moment_of_loading_is_no_start():
    """Who was told to stop announces nothing, although all of it would be there."""
    with serving("told_to_stop", subprocess.PIPE) as process:
        code, err = ended(process)
        out = process.stdout.read()
    assert code == 0
    assert "announced" not in err
    assert "ready " not in out
