"""Where frames come in and answers go out; one implementation per network, one for tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

OnMessage: TypeAlias = Callable[[str | None, bytes | memoryview, int], None]
"""Takes the drone that the network says it is from (None: it names none, and the message is there
to be counted), the bytes of one message (FRAME or PROBE), and t2, the worker's monotonic time [ns]
of its last byte.

It is called from the network's own threads, maybe from several at once, and never raises."""


class Transport(Protocol):
    """A worker's side of the link to its drones; all methods may be called from any thread."""

    @property
    def is_open(self) -> bool:
        """Frames can come in: the listeners stand, or the router is connected."""
        ...

    @property
    def is_alive(self) -> bool:
        """No thread of its own has ended before it was to."""
        ...

    def open(self) -> None:
        """Open the link.

        Raises:
            AddressError: an address cannot be used; says which one and why.
        """
        ...

    def start(self, on_message: OnMessage) -> None:
        """Hand over every message that arrives on the open link."""
        ...

    def announce(self) -> None:
        """Tell drones that this worker takes frames."""
        ...

    def withdraw(self) -> None:
        """Tell drones to go elsewhere; the link stays open for what is on its way."""
        ...

    def send(self, drone: str, payload: bytes) -> bool:
        """Send an ack, an echo or a result to a drone; False: it cannot be, nothing was sent."""
        ...

    def publish(self, status: bytes) -> None:
        """Send a status to every drone that listens; dropped rather than waited for."""
        ...

    def close(self) -> None:
        """Close the link; nothing is handed over afterwards. May be called twice."""
        ...
