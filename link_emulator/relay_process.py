"""The relay from the outside: a process of its own, which the starter controls."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

from link_emulator.control import Control
from link_emulator.errors import EmulatorError
from link_emulator.impairments import Impairments

END_S = 5.0


class RelayProcess:
    """A running relay; ``close`` ends it.

    Args:
        job: what ``relay_main`` is to do, without what follows here.
        up: impairments from a (or the clients) to b (or the server).
        down: back; None: as ``up``.
        seed: of chance.
        control: where a Unix socket takes commands of other processes; None: nowhere.

    Raises:
        EmulatorError: it cannot be done; says why.
    """

    def __init__(
        self,
        job: dict[str, Any],
        up: Impairments,
        down: Impairments | None,
        seed: int,
        control: Path | None,
    ) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "link_emulator.relay_main", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # a signal to our group shall not end it before us
            )
        self.control = Control(ours)
        whole = job | {
            "up": up.as_json(),
            "down": (up if down is None else down).as_json(),
            "seed": seed,
            "control": None if control is None else str(control.resolve()),
        }
        try:
            self.port = int(self.control.ask(whole)["port"])
        except EmulatorError:
            self.close()
            raise

    @property
    def pid(self) -> int:
        """Of the relay."""
        return self._process.pid

    def close(self) -> None:
        """End the relay."""
        self.control.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
