"""The socket shell on loopback, with and without the kernel's help."""

from __future__ import annotations

import errno
import random
import select
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.tunnel.datagrams import (
    MAX_SEGMENTS,
    DatagramSocket,
    _groups,
    bind_datagrams,
    connect_datagrams,
)


def take(sock: DatagramSocket, count: int) -> list[bytes]:
    """``count`` datagrams of a socket."""
    got: list[bytes] = []
    poller = select.poll()
    poller.register(sock.fileno(), select.POLLIN)
    while len(got) < count:
        assert poller.poll(5000), f"{len(got)} of {count} datagrams came"
        while (batch := sock.receive()) is not None:
            data, segment, _ = batch
            got += [bytes(data[i : i + segment]) for i in range(0, len(data), segment)]
    return got


@given(st.lists(st.binary(min_size=1, max_size=9), max_size=200))
def test_runs_are_what_the_kernel_can_cut(datagrams: list[bytes]) -> None:
    """Order stays; in a run all have one length, but the last may be shorter."""
    groups = _groups(datagrams)
    assert [d for group in groups for d in group] == datagrams
    for group in groups:
        assert 1 <= len(group) <= MAX_SEGMENTS
        assert {len(d) for d in group[:-1]} <= {len(group[0])}
        assert len(group[-1]) <= len(group[0])


@pytest.mark.parametrize("segments", [True, False])
@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_what_is_sent_arrives_in_order(segments: bool, host: str) -> None:
    """A frame's datagrams and small ones between, both ways, by any system call."""
    rng = random.Random(1)
    sizes = [1200] * 60 + [77, 1200, 1200, 600, 43, 43]
    datagrams = [rng.randbytes(size) for size in sizes]
    server = bind_datagrams(host, 0)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    client = connect_datagrams(family, (host, server.port))
    try:
        client.segments = client.segments and segments
        assert client.send(datagrams) == len(datagrams)
        assert take(server, len(datagrams)) == datagrams
        assert server.send(datagrams[-2:], (host, client.port)) == 2
        assert take(client, 2) == datagrams[-2:]
        assert client.receive() is None
    finally:
        server.close()
        client.close()


def test_a_device_that_cannot_cut_gets_single_datagrams(monkeypatch: pytest.MonkeyPatch) -> None:
    """EIO for a run: it is sent again one by one, and runs are not tried any more."""
    server = bind_datagrams("127.0.0.1", 0)
    client = connect_datagrams(socket.AF_INET, ("127.0.0.1", server.port))
    try:
        client.segments = True
        plain = client._send_group

        def refuse(group: list[bytes], address: object) -> None:
            if len(group) > 1:
                raise OSError(errno.EIO, "no checksums on this device")
            plain(group, address)

        monkeypatch.setattr(client, "_send_group", refuse)
        datagrams = [bytes([i]) * 100 for i in range(5)]
        assert client.send(datagrams) == 5
        assert not client.segments
        assert take(server, 5) == datagrams
    finally:
        server.close()
        client.close()


def test_nobody_there_is_noticed() -> None:
    """A port that nobody listens on says so to a connected socket."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    client = connect_datagrams(socket.AF_INET, ("127.0.0.1", port))
    try:
        client.send([b"x"])
        select.select([client], [], [], 5)
        with pytest.raises(ConnectionRefusedError):
            client.receive()
    finally:
        client.close()


def test_a_taken_port_is_an_error_and_leaks_nothing() -> None:
    """Binding twice fails; with warnings as errors, a socket left open would fail the test."""
    server = bind_datagrams("127.0.0.1", 0)
    try:
        with pytest.raises(OSError, match="in use"):
            bind_datagrams("127.0.0.1", server.port)
    finally:
        server.close()
