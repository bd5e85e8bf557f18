"""Commands that fly in a simulated world, in real processes; found again by a mark they carry."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

MARK = "AERIAL_CONTACT_TEST"
"""A variable that whatever a command starts has from it."""
PATIENCE_S = 180.0
FLY = str(Path(sys.executable).with_name("drone-client")), "fly"
SIMULATOR = sys.executable, "-m", "contact_sim"


class FlightProcess:
    """A running command, and all that has come of it."""

    def __init__(self, command: tuple[str, ...], variables: Mapping[str, str], log: Path) -> None:
        self.mark = f"{MARK}={secrets.token_hex(8)}".encode()
        env = os.environ | dict(variables) | {MARK: self.mark.decode().partition("=")[2]}
        self.log = log
        with log.open("wb") as file:
            self.process = subprocess.Popen(
                command, env=env, stdin=subprocess.DEVNULL, stdout=file, stderr=file
            )

    def all(self) -> dict[int, str]:
        """Every process of it that runs, by its number, with its command line."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if self.mark not in (folder / "environ").read_bytes().split(b"\0"):
                    continue
                line = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                if line:  # a zombie has none
                    found[int(folder.name)] = line
        return found

    def wait_until(self, what: Callable[[], bool]) -> None:
        """Wait for something to happen while it runs."""
        give_up = time.monotonic() + PATIENCE_S
        while not what():
            assert self.process.poll() is None, self.log.read_text()
            assert time.monotonic() < give_up, self.log.read_text()
            time.sleep(0.05)

    def left(self, within_s: float) -> dict[int, str]:
        """What still runs of it after a time at most."""
        give_up = time.monotonic() + within_s
        while (those := self.all()) and time.monotonic() < give_up:
            time.sleep(0.05)
        return those


@contextmanager
def flight_process(
    *command: str, log: Path, variables: Mapping[str, str] | None = None
) -> Iterator[FlightProcess]:
    """It is gone afterwards, and whatever it has started."""
    running = FlightProcess(command, variables or {}, log)
    try:
        yield running
    finally:
        for number in running.all():
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        running.process.wait()
