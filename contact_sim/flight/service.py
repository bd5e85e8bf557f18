"""A real service in a process of its own, for a flight that is given none."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Final, Self

from contact_sim.errors import ServiceError

READY_S: Final = 120.0
READY_ANSWER_S: Final = 1.0
END_S: Final = 20.0
"""Time for the service to end when it is told to; then it is killed."""
KILLED_S: Final = 10.0
LOG_LINES: Final = 12

_DIRECT: Final = urllib.request.build_opener(urllib.request.ProxyHandler({}))
"""A proxy of the environment is no way to the loopback of this machine."""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class ServiceProcess:
    """``edge-service serve`` on loopback; ends with the context, whatever happens in it.

    It is tied to this process (``tied``): it ends as well when this one is killed.

    Raises:
        ServiceError: it cannot be started, ended before it was ready, or takes too long.
    """

    def __init__(self, folder: Path, *options: str) -> None:
        """Start it, and wait until it serves.

        Args:
            folder: where its log goes.
            options: of ``edge-service serve``, beside the addresses.
        """
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.http = f"127.0.0.1:{free_port()}"
        self.log = folder / "edge-service.log"
        executable = Path(sys.executable).with_name("edge-service")
        if not executable.exists():
            raise ServiceError(
                "there is no edge-service beside this Python: install aerial-contact[edge], or "
                "give --connect the address of one that runs elsewhere"
            )
        tied = [sys.executable, "-m", "contact_sim.flight.tied", f"{END_S:g}"]
        command = [str(executable), "serve", "--listen", self.endpoint, "--http", self.http]
        # One thread of torch, and of numpy: the drone and its world need the other cores, and a
        # numeric library that waits for threads without a core takes thrice as long
        env = ONE_THREAD | os.environ | {"EDGE_THREADS": "1"}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with self.log.open("wb") as log:
                self._process = subprocess.Popen(
                    [*tied, *command, *options],
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=log,
                    env=env,
                    # a Ctrl-C is for the flight; the service ends after it
                    start_new_session=True,
                )
        except OSError as error:
            raise ServiceError(f"the service could not be started: {error}") from None
        try:
            self._wait_ready()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End it, gently at first."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(END_S + KILLED_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _wait_ready(self) -> None:
        give_up = time.monotonic() + READY_S
        while time.monotonic() < give_up:
            if self._process.poll() is not None:
                raise ServiceError(f"the service ended before it was ready:\n{self._last_lines()}")
            if answers_ready(self.http):
                return
            time.sleep(0.1)
        raise ServiceError(f"the service was not ready within {READY_S:g} s:\n{self._last_lines()}")

    def _last_lines(self) -> str:
        with contextlib.suppress(OSError):
            lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
            return "\n".join(lines[-LOG_LINES:])
        return f"(no log at {self.log})"


def answers_ready(http: str) -> bool:
    """Whether a service at this host and port of loopback says that it serves."""
    with (
        contextlib.suppress(OSError),
        _DIRECT.open(f"http://{http}/readyz", timeout=READY_ANSWER_S),
    ):
        return True
    return False


def free_port() -> int:
    """A TCP port that is free now."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def free_udp_port() -> int:
    """A UDP port that is free now."""
    with socket.socket(type=socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])
