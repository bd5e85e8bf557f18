"""The worker's end of the tunnel on a host with several addresses and a small buffer."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from edge_service.transport import udp
from edge_service.transport.udp import UdpTransport
from rgbd_wire.tunnel import datagrams
from rgbd_wire.tunnel.keys import KeyFile
from tests.integration.udp_ends import KEYS, Drone, write_keys


@pytest.fixture
def worker(tmp_path: Path) -> Iterator[UdpTransport]:
    """One that listens on every address of this machine, not yet open."""
    keys = KeyFile(write_keys(tmp_path / "drones.keys", KEYS))
    transport = UdpTransport("worker-a", "udp/0.0.0.0:0", keys)
    yield transport
    transport.close()


def test_a_drone_comes_in_at_any_address_of_a_worker(worker: UdpTransport) -> None:
    """Its socket takes no datagram from another address than the one that it was given."""
    worker.open()
    worker.start(lambda drone, data, _: worker.send(drone, bytes(data)))
    worker.announce()
    drone = Drone(worker.port, host="127.0.0.2")
    try:
        drone.up("worker-a")
        drone.ask(b"a question")
    finally:
        drone.link.close()


@pytest.mark.parametrize("is_short", [True, False])
def test_a_buffer_that_is_smaller_than_asked_for_is_told_once(
    worker: UdpTransport,
    is_short: bool,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """With what it got, and what to type; all is silent where the kernel gave it all."""
    asked = 2**30 if is_short else 4096
    for module in (datagrams, udp):
        monkeypatch.setattr(module, "SOCKET_BUFFER_BYTES", asked)
    with caplog.at_level(logging.WARNING):
        worker.open()
    told = [r.getMessage() for r in caplog.records]
    assert len(told) == is_short
    assert all(f"of {asked}" in line for line in told)
    assert all(f"sysctl -w net.core.rmem_max={asked}" in line for line in told)
