"""A real edge-service process, for tests and benches."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from pathlib import Path

from contact_sim.flight.service import free_port, free_udp_port

__all__ = ["ServiceProcess", "free_port", "free_udp_port", "service_process"]

END_S = 60.0
READY_S = 120.0
"""A machine may be five times slower than ours."""


class ServiceProcess:
    """``edge-service serve`` on loopback ports that stay the same over restarts."""

    def __init__(
        self, folder: Path, name: str = "worker", env: Mapping[str, str] | None = None
    ) -> None:
        self.name = name
        # One thread: with more, torch waits in every layer for whichever of them has no core just
        # now, and a machine shared with other work becomes a hundred times slower
        self._env = os.environ | {"EDGE_THREADS": "1"} | (env or {})
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.http = f"127.0.0.1:{free_port()}"
        self.log = folder / f"{name}.log"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the process; returns at once."""
        executable = Path(sys.executable).with_name("edge-service")
        options = ["--listen", self.endpoint, "--http", self.http, "--name", self.name]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [str(executable), "serve", *options], stdout=log, stderr=log, env=self._env
            )

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """The running process."""
        assert self._process is not None
        return self._process

    def wait_ready(self) -> None:
        """Wait until it serves; fails with its log if it ends or takes too long."""
        give_up = time.monotonic() + READY_S
        while time.monotonic() < give_up and self.process.poll() is None:
            with contextlib.suppress(OSError):
                urllib.request.urlopen(f"http://{self.http}/readyz", timeout=1)
                return
            time.sleep(0.05)
        raise AssertionError(f"the service is not ready:\n{self.log.read_text()}")

    def kill(self) -> None:
        """SIGKILL: no goodbye."""
        self.process.kill()
        self.process.wait()

    def close(self) -> None:
        """Whatever became of it: it is gone, be it never started, stopped or suspended."""
        if self._process is not None and self._process.poll() is None:
            self.kill()

    def stop(self) -> int:
        """SIGTERM; returns the exit code."""
        self.process.terminate()
        return self.process.wait(END_S)


@contextlib.contextmanager
def service_process(
    folder: Path, name: str = "worker", env: Mapping[str, str] | None = None
) -> Iterator[ServiceProcess]:
    """A service that is ready, and gone afterwards; ``env`` is added to its environment."""
    service = ServiceProcess(folder, name, env)
    with contextlib.closing(service):
        service.start()
        service.wait_ready()
        yield service
