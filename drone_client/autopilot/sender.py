"""Messages onto the line, numbered one after the other; from any thread, without waiting."""

from __future__ import annotations

import threading
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot.line import Line
from drone_client.autopilot.receiver import Receiver
from drone_client.autopilot.settings import AutopilotSettings


class Sender:
    """Packs as MAVLink 2 and writes whole messages."""

    def __init__(self, line: Line, receiver: Receiver, settings: AutopilotSettings) -> None:
        """Take over the line's sending side.

        Args:
            line: open.
            receiver: knows which vehicle it is.
            settings: our own ids.
        """
        self._line = line
        self._receiver = receiver
        self._settings = settings
        self._lock = threading.Lock()
        self._packer = mav.MAVLink(None, srcSystem=1, srcComponent=settings.own_component)

    @property
    def own_system(self) -> int:
        """Our system id: the vehicle's, unless another one is set."""
        return self._settings.own_system or self._receiver.system or 1

    def to_vehicle(self, build: Callable[[int, int], mav.MAVLink_message]) -> bool:
        """Send what is addressed to the vehicle, once it is known; False: it did not leave.

        Args:
            build: makes the message for a system and a component.
        """
        system = self._receiver.system
        return system is not None and self.send(build(system, self._receiver.component))

    def send(self, message: mav.MAVLink_message) -> bool:
        """Send a message; False: the line dropped it."""
        with self._lock:
            self._packer.srcSystem = self.own_system
            data = message.pack(self._packer)
            self._packer.seq = (self._packer.seq + 1) % 256
            return self._line.write(data)
