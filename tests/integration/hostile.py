"""What the tests of adversaries share: a service on both networks and its counts."""

from __future__ import annotations

import os
import resource
import socket
import time
import urllib.request
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

from rgbd_wire.tunnel.packet import Type, first_byte
from tests.integration.udp_ends import write_keys
from tests.service_process import ServiceProcess, free_udp_port
from tests.unit.edge_service.edge_fakes import SECOND_NS, message

KEYS = {f"d{i}": bytes([i]) * 16 + b"0123456789abcdef" for i in range(1, 7)}
UP = first_byte(Type.UP)
BUDGET_NS = 60 * SECOND_NS
_SEQUENCES = count(os.getpid() % 1000 * 100_000)


class Service:
    """A service process that listens on Zenoh and on the tunnel."""

    def __init__(self, folder: Path, **variables: str) -> None:
        self.keys = write_keys(folder / "keys", KEYS)
        self.udp_port = free_udp_port()
        env = {
            "EDGE_UDP_LISTEN": f"127.0.0.1:{self.udp_port}",
            "EDGE_TUNNEL_KEYS": str(self.keys),
        }
        self.process = ServiceProcess(folder, "w1", env | variables)
        self.udp = f"udp/127.0.0.1:{self.udp_port}"
        self.place = ("127.0.0.1", self.udp_port)

    def metrics(self) -> dict[str, float]:
        """Every sample by its name and labels."""
        with urllib.request.urlopen(f"http://{self.process.http}/metrics", timeout=10) as answer:
            lines = answer.read().decode().splitlines()
        pairs = (line.rsplit(" ", 1) for line in lines if not line.startswith("#"))
        return {name: float(value) for name, value in pairs}

    def refused(self, reason: str) -> float:
        """How much the tunnel refused for a reason."""
        return self.metrics()[f'edge_tunnel_refused_total{{reason="{reason}"}}']

    def rejected(self, reason: str) -> float:
        """How many messages the service refused for a reason."""
        return self.metrics()[f'edge_rejected_total{{reason="{reason}"}}']

    def resident_bytes(self) -> int:
        """Memory of the process that is in use."""
        pages = Path(f"/proc/{self.process.process.pid}/statm").read_text().split()[1]
        return int(pages) * resource.getpagesize()


def until(what: Callable[[], object], within_s: float = 15.0) -> None:
    """Look until something holds."""
    end_s = time.monotonic() + within_s
    while not what():
        assert time.monotonic() < end_s, "it never came about"
        time.sleep(0.02)  # a look, not a synchronisation: the bound above is what is waited for


def frame(name: str) -> tuple[int, bytes]:
    """A frame of a drone, with a sequence of its own: no service takes one twice."""
    sequence = next(_SEQUENCES)
    return sequence, message(drone=name, sequence=sequence, budget_ns=BUDGET_NS)


def ask(drone: Any, name: str) -> int:
    """Send a frame of a drone and wait for its result; its sequence."""
    sequence, data = frame(name)
    drone.send(data)
    drone.wait_for(lambda d: any(r.sequence == sequence for r in d.results))
    return sequence


def ask_until_answered(drone: Any, name: str, within_s: float = 30.0) -> None:
    """Send frames of a drone, one every 200 ms, until one of them has its result.

    For a drone whose service is being flooded: what does not fit into the service's socket is
    lost there, a frame of an honest drone like anything else, and nobody sends it again.
    """
    sent = set()

    def one_more() -> bool:
        sequence, data = frame(name)
        sent.add(sequence)
        drone.send(data)
        return drone.waits_for(lambda d: any(r.sequence in sent for r in d.results), 0.2)

    until(one_more, within_s)


def udp_socket() -> socket.socket:
    """A socket on loopback that waits for nothing."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.setblocking(False)
    return sock


def received_bytes(sock: socket.socket) -> int:
    """Bytes of all datagrams that wait at a socket."""
    total = 0
    while True:
        try:
            total += len(sock.recv(4096))
        except BlockingIOError:
            return total
