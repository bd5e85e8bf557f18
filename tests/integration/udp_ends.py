"""Both ends of the tunnel for tests, and a relay between them that loses what it is told to."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

from drone_client.link.udp import UdpLink
from edge_service.transport.udp import UdpTransport
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.tunnel.keys import KeyFile

KEYS = {f"drone-{i}": bytes([i]) * 16 + b"0123456789abcdef" for i in range(1, 9)}


def write_keys(path: Path, keys: dict[str, bytes]) -> Path:
    """A key file, put in place at once."""
    new = path.with_suffix(".new")
    new.write_text("".join(f"{n} {k.hex()}\n" for n, k in keys.items()), encoding="ascii")
    new.chmod(0o600)
    new.replace(path)
    return path


def eventually(what: Callable[[], object], within_s: float = 10.0) -> None:
    """Wait until something holds."""
    end_s = time.monotonic() + within_s
    while not what():
        assert time.monotonic() < end_s, "it never came about"
        time.sleep(0.005)  # a look, not a synchronisation: the bound above is what is waited for


class Worker:
    """A transport that keeps what came, and answers it with its first bytes."""

    def __init__(self, keys: Path, name: str = "worker-a", port: int = 0) -> None:
        self.got: list[tuple[str, bytes, int]] = []
        self.transport = UdpTransport(name, f"udp/127.0.0.1:{port}", KeyFile(keys))
        self.transport.open()
        self.port = self.transport.port
        self.transport.start(self._on_message)
        self.transport.announce()

    def _on_message(self, drone: str, data: bytes | memoryview, t2_ns: int) -> None:
        self.got.append((drone, bytes(data), t2_ns))
        self.transport.send(drone, bytes(data[:500]))

    def counts(self) -> dict[str, int]:
        return {name: n for name, n in self.transport.counters().items() if n}


class Drone:
    """A link that keeps what came."""

    def __init__(
        self,
        *ports: int,
        name: str = "drone-1",
        key: bytes | None = None,
        host: str = "127.0.0.1",
    ) -> None:
        self.got: list[bytes] = []
        self.changes: list[tuple[str, ...]] = []
        endpoints = tuple(f"udp/{host}:{port}" for port in ports)
        self.link = UdpLink(name, endpoints, key or KEYS[name], MonotonicClock())
        self.link.start(self._on_message, self._on_workers)

    def _on_message(self, message: bytes, t4_ns: int) -> None:
        assert t4_ns <= time.monotonic_ns()
        self.got.append(message)

    def _on_workers(self) -> None:
        self.changes.append(self.link.workers())

    def up(self, *workers: str) -> None:
        eventually(lambda: self.link.workers() == workers)

    def ask(self, message: bytes, worker: str = "worker-a") -> None:
        """Send a frame and wait for its answer."""
        self.link.send(worker, message, 10**9)
        eventually(lambda: message[:500] in self.got)


class Relay:
    """A UDP relay on loopback for one worker; every client has its own socket towards it.

    Args:
        port: of the worker.
        lost: told the direction (True: to the worker) and the datagram; True loses it.
    """

    def __init__(self, port: int, lost: Callable[[bool, bytes], bool]) -> None:
        self._worker = ("127.0.0.1", port)
        self.lost = lost
        self.seen: list[tuple[bool, bytes]] = []
        self._front = self._socket()
        self._front.bind(("127.0.0.1", 0))
        self.port = self._front.getsockname()[1]
        self._backs: dict[tuple[str, int], socket.socket] = {}
        self._sockets = [self._front]
        self._closed = False
        self._threads = [threading.Thread(target=self._up)]
        self._threads[0].start()

    @staticmethod
    def _socket() -> socket.socket:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, 4 << 20)
        sock.settimeout(0.05)
        return sock

    def _pass(self, up: bool, datagram: bytes) -> bool:
        self.seen.append((up, datagram))
        return not self.lost(up, datagram)

    def _up(self) -> None:
        while not self._closed:
            try:
                datagram, client = self._front.recvfrom(2048)
            except TimeoutError:
                continue
            back = self._backs.get(client)
            if back is None:
                back = self._backs[client] = self._socket()
                back.connect(self._worker)
                self._sockets.append(back)
                thread = threading.Thread(target=self._down, args=(back, client))
                self._threads.append(thread)
                thread.start()
            if self._pass(True, datagram):
                with contextlib.suppress(ConnectionRefusedError):  # the worker is away
                    back.send(datagram)

    def _down(self, back: socket.socket, client: tuple[str, int]) -> None:
        while not self._closed:
            try:
                datagram = back.recv(2048)
            except (TimeoutError, ConnectionRefusedError):
                continue
            if self._pass(False, datagram):
                self._front.sendto(datagram, client)

    def close(self) -> None:
        self._closed = True
        for thread in self._threads:
            thread.join()
        for sock in self._sockets:
            sock.close()
