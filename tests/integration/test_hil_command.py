"""``python -m contact_sim hil`` as a process: what a person types, sees and interrupts."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

PEER = Path(__file__).with_name("px4_hil_peer.py")
GIVE_UP_S = 60.0


class Command:
    """The process, and what it says while it runs."""

    def __init__(self, *options: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "contact_sim", "hil", "--listen", "127.0.0.1:0", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"COLUMNS": "200", "NO_COLOR": "1"},
        )
        self.said: list[str] = []
        self._more = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def wait_for(self, pattern: str) -> re.Match[str]:
        """Until it has said so."""
        end = time.monotonic() + GIVE_UP_S
        with self._more:
            while True:
                for line in self.said:
                    if match := re.search(pattern, line):
                        return match
                left = end - time.monotonic()
                assert left > 0, f"never {pattern!r}: {self.said}"
                assert self.process.poll() is None, f"ended before {pattern!r}: {self.said}"
                self._more.wait(min(left, 0.2))

    def address(self) -> str:
        return self.wait_for(r"waits for PX4 at (\S+)")[1]

    def interrupt(self) -> None:
        self.process.send_signal(signal.SIGINT)

    def end(self) -> tuple[int, str]:
        """Exit code and standard output, once it has ended."""
        assert self.process.stdout is not None
        out = self.process.stdout.read()
        self.process.wait(GIVE_UP_S)
        self._reader.join(GIVE_UP_S)
        return self.process.returncode, out

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join(GIVE_UP_S)
        for pipe in (self.process.stdout, self.process.stderr):
            assert pipe is not None
            pipe.close()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            with self._more:
                self.said.append(line)
                self._more.notify_all()


@contextmanager
def command(*options: str) -> Iterator[Command]:
    running = Command(*options)
    try:
        yield running
    finally:
        running.close()


def stand_in(address: str, *options: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, str(PEER), "--connect", address, *options], stdout=subprocess.DEVNULL
    )


def test_flights_end_in_a_summary_for_programs() -> None:
    """Two flights, each with its reason, numbers and outcome; then it ends by itself."""
    with command("--flights", "2", "--speed", "0", "--world", "refinery", "--json") as hil:
        address = hil.address()
        for seconds in ("3", "4"):
            with stand_in(address, "--seconds", seconds) as peer:
                assert peer.wait(GIVE_UP_S) == 0
        code, out = hil.end()
        summary = json.loads(out)
    assert code == 0
    assert (summary["world"], summary["flown"], summary["listened"]) == ("refinery", 2, address)
    first, second = summary["flights"]
    assert "the connection" in first["why"]
    assert first["simulated_s"] == pytest.approx(3.0, abs=0.1)
    assert second["armed_s"] == pytest.approx(3.0, abs=0.1)
    assert (
        second["counts"]["answered"] >= 700
    )  # disarmed, on a busy machine, not all are waited for
    assert second["outcome"]["touched"] is False
    assert sum("armed at 1." in line for line in hil.said) == 2


def test_an_interrupt_ends_a_flight_cleanly() -> None:
    """Ctrl-C in flight: the summary is whole, the exit code 0, and nothing is left behind."""
    with command("--json") as hil:
        with stand_in(hil.address(), "--seconds", "1000") as peer:
            try:
                hil.wait_for("armed at")
                hil.interrupt()
                code, out = hil.end()
            finally:
                peer.kill()
        (flight,) = json.loads(out)["flights"]
    assert code == 0
    assert flight["why"] == "interrupted"
    assert not flight["failed"]
    assert flight["simulated_s"] >= 1.0
    assert not any("Traceback" in line for line in hil.said)


def test_an_interrupt_while_it_waits_ends_it_too() -> None:
    """Nobody flew, and that is said."""
    with command("--json") as hil:
        hil.address()
        hil.interrupt()
        code, out = hil.end()
    assert (code, json.loads(out)["flights"]) == (0, [])


def test_a_second_one_is_turned_away_while_one_flies() -> None:
    """One drone, one PX4: who comes while another flies is closed at once, and counted."""
    with command("--json") as hil:
        address = hil.address()
        host, _, port = address.rpartition(":")
        with stand_in(address, "--seconds", "1000") as peer:
            try:
                hil.wait_for("armed at")
                with socket.create_connection((host, int(port)), timeout=GIVE_UP_S) as second:
                    assert second.recv(1) == b""
                hil.wait_for("turned away 1 more")
                hil.interrupt()
                code, out = hil.end()
            finally:
                peer.kill()
    assert code == 0
    assert json.loads(out)["turned_away"] == 1


def test_a_peer_that_cannot_fly_is_a_fault() -> None:
    """Exit code 3, and the reason in words on the terminal."""
    with (
        command("--flights", "1", "--boot-s", "0.5") as hil,
        stand_in(hil.address(), "--fault", "silent") as peer,
    ):
        code, out = hil.end()
        assert peer.wait(GIVE_UP_S) == 0
    assert code == 3
    assert any("never sent HIL_ACTUATOR_CONTROLS" in line for line in hil.said)
    assert "boots" not in out
    assert "the last flight" in out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--listen", "4560"), "is no address to listen at, such as 127.0.0.1:4560"),
        (("--listen", "192.0.2.1:4560"), "192.0.2.1 is not an address of this machine"),
        (("--listen", "127.0.0.1:0", "--world", "moon"), "no world 'moon'; there are: tunnel"),
    ],
)
def test_a_mistake_is_one_line(options: tuple[str, ...], words: str) -> None:
    """Exit code 2, without a traceback."""
    ended = subprocess.run(
        [sys.executable, "-m", "contact_sim", "hil", *options],
        capture_output=True,
        text=True,
        timeout=GIVE_UP_S,
        check=False,
    )
    assert ended.returncode == 2
    assert words in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_port_that_is_taken_is_said() -> None:
    """And what to do about it."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = f"127.0.0.1:{other.getsockname()[1]}"
        ended = subprocess.run(
            [sys.executable, "-m", "contact_sim", "hil", "--listen", taken],
            capture_output=True,
            text=True,
            timeout=GIVE_UP_S,
            check=False,
        )
    assert ended.returncode == 2
    assert f"{taken}: the port is taken" in ended.stderr
