"""TCP: a door that PX4 knocks at, and the line to whoever came in. Nothing here waits for ever."""

from __future__ import annotations

import errno
import select
import socket
import time
from typing import Final

from contact_sim.errors import HilError, PeerGoneError

READ_MAX: Final = 16_384
SEND_S: Final = 5.0
"""A peer that reads nothing for so long hangs."""
MAX_HOST: Final = 255
MAX_STRANGERS: Final = 32
"""Turned away at one look."""


class Line:
    """A connection with one peer."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data: bytes) -> None:
        """Send all of it.

        Raises:
            PeerGoneError: the peer went.
            HilError: it does not read.
        """
        give_up = time.monotonic() + SEND_S
        left = memoryview(data)
        while left:
            try:
                left = left[self._socket.send(left) :]
            except BlockingIOError:
                wait_s = give_up - time.monotonic()
                if wait_s <= 0 or not select.select([], [self._socket], [], wait_s)[1]:
                    raise HilError(f"the peer has read nothing for {SEND_S:g} s: hung?") from None
            except OSError as error:
                raise PeerGoneError(_went(error)) from None

    def receive(self, timeout_s: float) -> bytes:
        """What came; empty: nothing within the time.

        Raises:
            PeerGoneError: the peer went.
        """
        try:
            if not select.select([self._socket], [], [], max(0.0, timeout_s))[0]:
                return b""
            data = self._socket.recv(READ_MAX)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise PeerGoneError(_went(error)) from None
        if not data:
            raise PeerGoneError("the peer closed the connection")
        return data

    def close(self) -> None:
        """Close it."""
        self._socket.close()


class Door:
    """Listens; one peer at a time.

    Raises:
        HilError: the address is none of this machine, or taken.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            family, kind, _, _, address = socket.getaddrinfo(
                host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            self._socket = socket.socket(family, kind)
        except OSError as error:
            raise HilError(f"{host}:{port}: the host cannot be resolved ({error})") from None
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.setblocking(False)
            self._socket.bind(address)
            self._socket.listen(8)
        except OSError as error:
            self._socket.close()
            raise HilError(f"{host}:{port}: {_why_not(error, host)}") from None
        self.address: tuple[str, int] = self._socket.getsockname()[:2]
        """Where it listens."""

    def wait(self, timeout_s: float) -> Line | None:
        """The next peer; None: none came within the time."""
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return None
        try:
            connected, _ = self._socket.accept()
        except OSError:
            return None  # it went before it was let in
        return Line(connected)

    def turn_away(self) -> int:
        """Close whoever knocks while another flies; returns how many they were."""
        for number in range(MAX_STRANGERS):
            line = self.wait(0.0)
            if line is None:
                return number
            line.close()
        return MAX_STRANGERS

    def close(self) -> None:
        """Listen no more."""
        self._socket.close()


def address_of(text: str) -> tuple[str, int]:
    """Host and port of ``HOST:PORT``; a port of 0 takes any that is free.

    Raises:
        HilError: it is none.
    """
    host, colon, digits = text.rpartition(":")
    port = int(digits) if digits.isascii() and digits.isdigit() and len(digits) <= 5 else -1
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    if not colon or not host or len(host) > MAX_HOST or not 0 <= port <= 0xFFFF:
        raise HilError(f"{text[:80]!r} is no address to listen at, such as 127.0.0.1:4560")
    return host, port


def _went(error: OSError) -> str:
    return f"the connection broke ({error.strerror or error})"


def _why_not(error: OSError, host: str) -> str:
    if error.errno == errno.EADDRINUSE:
        return "the port is taken: end the other simulator (Gazebo? jMAVSim?), or take another"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{host} is not an address of this machine"
    return error.strerror or str(error)
