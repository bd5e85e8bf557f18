"""A transport made of several: one worker on more than one network at once."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from contextlib import ExitStack

from edge_service.transport import OnMessage, Transport

MAX_DRONES = 4096
"""Whose network is remembered; a name is up to whoever sends where the network has no keys."""


class SeveralTransports:
    """Takes from all of its transports, and answers a drone on the one it was last heard on."""

    def __init__(self, transports: Sequence[Transport]) -> None:
        assert transports, "at least one"
        self._transports = tuple(transports)
        self._heard: OrderedDict[str, Transport] = OrderedDict()  # noted longest ago first
        self._lock = threading.Lock()

    @property
    def is_open(self) -> bool:
        """All of them are: a worker with half of its ears is not ready."""
        return all(transport.is_open for transport in self._transports)

    @property
    def is_alive(self) -> bool:
        """All of them are."""
        return all(transport.is_alive for transport in self._transports)

    def open(self) -> None:
        """Open all, or none.

        Raises:
            AddressError: the first that cannot be opened.
        """
        with ExitStack() as opened:
            for transport in self._transports:
                transport.open()
                opened.callback(transport.close)
            opened.pop_all()

    def start(self, on_message: OnMessage) -> None:
        """Hand over what arrives on any of them."""
        for transport in self._transports:
            transport.start(self._noting(transport, on_message))

    def announce(self) -> None:
        """Tell the drones of every network."""
        for transport in self._transports:
            transport.announce()

    def withdraw(self) -> None:
        """Tell the drones of every network to go elsewhere."""
        for transport in self._transports:
            transport.withdraw()

    def send(self, drone: str, payload: bytes) -> bool:
        """Send where the drone was last heard; where that is forgotten, on all networks."""
        heard = self._heard.get(drone)
        if heard is not None:
            return heard.send(drone, payload)
        sent = [transport.send(drone, payload) for transport in self._transports]
        return any(sent)

    def publish(self, status: bytes) -> None:
        """Send a status on every network."""
        for transport in self._transports:
            transport.publish(status)

    def close(self) -> None:
        """Close all, each whatever becomes of the others."""
        with ExitStack() as closing:
            for transport in self._transports:
                closing.callback(transport.close)

    def _noting(self, transport: Transport, on_message: OnMessage) -> OnMessage:
        def note_and_hand_over(drone: str | None, data: bytes | memoryview, t2_ns: int) -> None:
            if drone is not None and self._heard.get(drone) is not transport:
                self._note(drone, transport)
            on_message(drone, data, t2_ns)

        return note_and_hand_over

    def _note(self, drone: str, transport: Transport) -> None:
        with self._lock:
            self._heard[drone] = transport
            self._heard.move_to_end(drone)
            if len(self._heard) > MAX_DRONES:
                self._heard.popitem(last=False)
