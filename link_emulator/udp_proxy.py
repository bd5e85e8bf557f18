"""A bad link for UDP alone, without root: clients send to it instead of to the server."""

from __future__ import annotations

import socket
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from link_emulator.errors import ControlError
from link_emulator.lane import Lane
from link_emulator.loop import TURN, Loop
from link_emulator.path import Path

HEADER_BYTES = 28
"""IPv4 and UDP: the rate counts what would be on the air."""
MAX_CLIENTS = 256
MAX_DATAGRAM_BYTES = 65535
BUFFER_BYTES = 1 << 22
"""Asked for: a burst shall wait in the relay's own queue, not be lost in front of it."""


@dataclass(frozen=True, slots=True, eq=False)
class _Client:
    address: Any
    upstream: socket.socket
    """Of this client alone, so that the server tells clients apart."""


class UdpRelay:
    """Datagrams from any client to one server, and the answers back.

    Args:
        listen: host and port; port 0 is any free one.
        server: host and port.
        up: path from clients to the server, which they share.
        down: path back.

    Raises:
        ControlError: there is no such server.
        OSError: the address to listen at is not ours, or taken.
    """

    def __init__(
        self, listen: tuple[str, int], server: tuple[str, int], up: Path, down: Path
    ) -> None:
        self._family, self._server = _resolved(*server)
        self._socket = _socket()
        self._socket.bind(listen)
        self._clients: OrderedDict[Any, _Client] = OrderedDict()
        self.up: Lane[tuple[_Client, bytes]] = Lane(up, self._send_up, time.monotonic_ns)
        self.down: Lane[tuple[_Client, bytes]] = Lane(down, self._send_down, time.monotonic_ns)
        self.loop = Loop((self.up, self.down))
        self.loop.add(self._socket.fileno(), self._on_clients)

    @property
    def port(self) -> int:
        """Where it listens."""
        port: int = self._socket.getsockname()[1]
        return port

    def _on_clients(self) -> None:
        for _ in range(TURN):
            try:
                data, address = self._socket.recvfrom(MAX_DATAGRAM_BYTES)
            except OSError:  # nothing more, or an ICMP error of an earlier one
                return
            try:
                client = self._client(address)
            except OSError:  # no descriptor left, or no way there: this one is lost, others come
                continue
            self.up.offer((client, data), len(data) + HEADER_BYTES, time.monotonic_ns())

    def _client(self, address: Any) -> _Client:
        client = self._clients.get(address)
        if client is None:
            if len(self._clients) >= MAX_CLIENTS:
                _, oldest = self._clients.popitem(last=False)
                self.loop.remove(oldest.upstream.fileno())
                oldest.upstream.close()
            upstream = _socket(self._family)
            try:
                upstream.connect(self._server)
            except OSError:
                upstream.close()
                raise
            client = self._clients[address] = _Client(address, upstream)
            self.loop.add(client.upstream.fileno(), self._on_server(client))
        self._clients.move_to_end(address)
        return client

    def _on_server(self, client: _Client) -> Callable[[], None]:
        def on_readable() -> None:
            for _ in range(TURN):
                try:
                    data = client.upstream.recv(MAX_DATAGRAM_BYTES)
                except OSError:
                    return
                self.down.offer((client, data), len(data) + HEADER_BYTES, time.monotonic_ns())

        return on_readable

    def _send_up(self, item: tuple[_Client, bytes]) -> bool:
        client, data = item
        try:
            return client.upstream.send(data) == len(data)
        except OSError:
            return False

    def _send_down(self, item: tuple[_Client, bytes]) -> bool:
        client, data = item
        try:
            return self._socket.sendto(data, client.address) == len(data)
        except OSError:
            return False


def _resolved(host: str, port: int) -> tuple[int, Any]:
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or "no name of a host"
        raise ControlError(f"--to {host}:{port}: {why}") from None
    return family, address


def _socket(family: int = socket.AF_INET) -> socket.socket:
    made = socket.socket(family, socket.SOCK_DGRAM)
    made.setblocking(False)
    for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        made.setsockopt(socket.SOL_SOCKET, option, BUFFER_BYTES)
    return made
