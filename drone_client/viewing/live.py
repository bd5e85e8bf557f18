"""A flight served live to Foxglove, from a process of its own: no viewer slows down a drone.

It reads the run's files as they grow, so that a hundredth of a second late is all that it is; and
it ends when the flight does, also one that was killed.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Final, NamedTuple

from rich.console import Console

from drone_client.errors import ClientError, OutputError

LOG_NAME: Final = "foxglove.log"
END_S: Final = 3.0
NICE: Final = 10
"""Whoever watches waits for whoever flies."""
HOST: Final = "127.0.0.1"


class Address(NamedTuple):
    """Where to serve."""

    host: str
    port: int


def parse_address(text: str) -> Address:
    """The address of ``[HOST:]PORT``.

    Raises:
        OutputError: it is none.
    """
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise OutputError(f"--foxglove {text}: give PORT or HOST:PORT, such as 8765")
    return Address(host or HOST, int(port))


def check_free(address: Address) -> None:
    """See early whether one could serve there.

    Raises:
        OutputError: somebody else does, or it is no address of this machine.
    """
    try:
        with socket.create_server(address):
            pass
    except (OSError, OverflowError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise OutputError(f"--foxglove {address.host}:{address.port}: {why}") from None


class LiveView:
    """The process that serves one run."""

    def __init__(self, run: Path, address: Address) -> None:
        self._run = run
        self._address = address
        self._process: subprocess.Popen[bytes] | None = None
        self.problem: str | None = None

    def start(self) -> None:
        """Start it; if it cannot be, that is a line in ``problem``."""
        host, port = self._address
        command = [sys.executable, "-m", "drone_client.viewing.live", str(self._run), host]
        try:
            with (self._run / LOG_NAME).open("wb") as log:
                self._process = subprocess.Popen(
                    [*command, str(port)],
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=log,
                    start_new_session=True,  # a Ctrl-C is for the flight
                )
        except OSError as error:
            self.problem = f"the live view could not be started: {error.strerror}"

    def close(self) -> None:
        """End it; also when it never ran, or has ended."""
        process = self._process
        if process is None:
            return
        if process.poll() is not None:
            self.problem = f"the live view ended early: see {self._run / LOG_NAME}"
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def main() -> None:
    """Serve ``RUN HOST PORT`` until standard input ends."""
    from drone_client.viewing.command import serve

    run, host, port = sys.argv[1:]
    over = threading.Event()

    def watch() -> None:
        sys.stdin.buffer.read()
        over.set()

    threading.Thread(target=watch, name="parent", daemon=True).start()
    with contextlib.suppress(OSError):
        os.nice(NICE)
    try:
        serve(Path(run), Address(host, int(port)), Console(), over)
    except ClientError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
