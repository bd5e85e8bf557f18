"""The relay's end of the control channel."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from link_emulator.control import DIRECTIONS, MAX_MESSAGE_BYTES
from link_emulator.errors import ControlError, EmulatorError
from link_emulator.histogram import Histogram
from link_emulator.impairments import Impairments
from link_emulator.lane import Lane
from link_emulator.loop import Loop
from link_emulator.report import Report, make_report


class Change(Protocol):
    """Makes one direction do something else."""

    def __call__(self, lane: Lane[Any], impairments: Impairments) -> None:
        """From now on.

        Raises:
            EmulatorError: this relay cannot.
        """
        ...


def change_path(lane: Lane[Any], impairments: Impairments) -> None:
    """What a relay does that can do everything."""
    lane.path.change(impairments)


class Served:
    """Answers the process that started the relay, and whoever connects to a path.

    Args:
        owner: the starter's channel; when it hangs up, the relay ends.
        loop: to be told of channels, and stopped.
        up: lane from a to b.
        down: lane from b to a.
        scheduling: what ``hurry`` gave.
        change: sets the impairments of a lane.
    """

    def __init__(
        self,
        owner: socket.socket,
        loop: Loop,
        up: Lane[Any],
        down: Lane[Any],
        scheduling: str,
        change: Change = change_path,
    ) -> None:
        self._loop = loop
        self._lanes = {"up": up, "down": down}
        self._scheduling = scheduling
        self._change = change
        self._actions: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
            "change": self._on_change,
            "report": lambda _: {"report": self.report().as_json()},
            "reset": self._on_reset,
            "stop": self._on_stop,
        }
        self._listener: socket.socket | None = None
        loop.add(owner.fileno(), lambda: self._on_readable(owner, is_owner=True))

    def listen(self, path: Path) -> None:
        """Take commands at a path, too."""
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        listener.bind(str(path))
        listener.listen(4)
        self._listener = listener  # or it would be collected, and closed
        self._loop.add(listener.fileno(), self._on_caller)

    def report(self) -> Report:
        """Since the start or the last reset."""
        errors = Histogram()
        for lane in self._lanes.values():
            errors.merge(lane.errors)
        up, down = self._lanes["up"].report(), self._lanes["down"].report()
        return make_report(up, down, errors, self._scheduling, time.process_time())

    def _on_caller(self) -> None:
        assert self._listener is not None
        caller, _ = self._listener.accept()
        self._loop.add(caller.fileno(), lambda: self._on_readable(caller, is_owner=False))

    def _on_readable(self, channel: socket.socket, *, is_owner: bool) -> None:
        try:
            data = channel.recv(MAX_MESSAGE_BYTES)
        except OSError:
            data = b""
        if not data:
            self._loop.remove(channel.fileno())
            channel.close()
            if is_owner:
                self._loop.stop()
            return
        try:
            answer = self._answer(data)
        except EmulatorError as error:
            answer = {"error": str(error)}
        try:
            channel.send(json.dumps(answer).encode())
        except OSError:
            return  # hung up meanwhile, which the next read will tell

    def _answer(self, data: bytes) -> dict[str, Any]:
        try:
            request = json.loads(data)
            action = self._actions[request["do"]]
        except (ValueError, KeyError, TypeError):
            raise ControlError(
                f'{data[:80]!r} is no request such as {{"do": "report"}}; there are '
                f"{', '.join(self._actions)}"
            ) from None
        return action(request)

    def _on_change(self, request: dict[str, Any]) -> dict[str, Any]:
        direction, changes = request.get("direction", "both"), request.get("changes")
        if direction not in DIRECTIONS:
            raise ControlError(f"no direction {direction!r}; there are {', '.join(DIRECTIONS)}")
        if not isinstance(changes, dict):
            raise ControlError('changes are an object such as {"loss": 0.1}')
        lanes = [lane for name, lane in self._lanes.items() if direction in (name, "both")]
        # All are looked at before one is changed: a refused request changes nothing
        wanted = [lane.path.impairments.changed(changes) for lane in lanes]
        for lane, impairments in zip(lanes, wanted, strict=True):
            self._change(lane, impairments)
        return {"ok": True}

    def _on_reset(self, _: dict[str, Any]) -> dict[str, Any]:
        for lane in self._lanes.values():
            lane.reset()
        return {"ok": True}

    def _on_stop(self, _: dict[str, Any]) -> dict[str, Any]:
        self._loop.stop()
        return {"ok": True}
