"""The small channel to a running relay: change the link, ask for the report.

One JSON object a message over a Unix socket that keeps messages apart (SOCK_SEQPACKET)::

    {"do": "change", "direction": "up" | "down" | "both", "changes": {"loss": 0.1, "burst": 4}}
    {"do": "report"}  {"do": "reset"}  {"do": "stop"}

Answers: ``{"ok": true}``, ``{"report": {...}}`` or ``{"error": "..."}``.
"""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from link_emulator.errors import ControlError
from link_emulator.report import Report

MAX_MESSAGE_BYTES = 65536
ANSWER_S = 10.0
DIRECTIONS = ("up", "down", "both")


class Control:
    """A client of a relay; may be called from any thread."""

    def __init__(self, channel: socket.socket) -> None:
        channel.settimeout(ANSWER_S)
        self._channel = channel
        self._lock = threading.Lock()

    @classmethod
    def connect(cls, path: Path) -> Control:
        """To a relay that was started with a control path.

        Raises:
            ControlError: nobody listens there.
        """
        channel = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            channel.connect(str(path))
        except OSError as error:
            channel.close()
            raise ControlError(f"no relay at {path}: {error.strerror}") from None
        return cls(channel)

    def change(self, direction: str = "both", **changes: Any) -> None:
        """Change impairments from now on; names and values as in ``Impairments``.

        Raises:
            ControlError: one of them is wrong, or the relay is gone.
        """
        self.ask({"do": "change", "direction": direction, "changes": changes})

    def cut(self, direction: str = "both") -> None:
        """Partition: nothing gets through until ``heal``."""
        self.change(direction, cut=True)

    def heal(self, direction: str = "both") -> None:
        """End the partition."""
        self.change(direction, cut=False)

    def report(self) -> Report:
        """What was passed and dropped, and how exactly, since the start or the last reset."""
        return Report.from_json(self.ask({"do": "report"})["report"])

    def reset(self) -> None:
        """Count from zero."""
        self.ask({"do": "reset"})

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Send one request and wait for its answer.

        Raises:
            ControlError: the relay is gone, or refused; says why.
        """
        with self._lock:
            try:
                self._channel.send(json.dumps(request).encode())
                answer = self._channel.recv(MAX_MESSAGE_BYTES)
            except OSError as error:
                raise ControlError(f"the relay does not answer: {error}") from None
        if not answer:
            raise ControlError("the relay is gone")
        told: dict[str, Any] = json.loads(answer)
        if "error" in told:
            raise ControlError(told["error"])
        return told

    def close(self) -> None:
        """Hang up; a relay whose starter hangs up ends."""
        self._channel.close()
