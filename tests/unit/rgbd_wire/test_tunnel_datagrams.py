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
    SOCKET_BUFFER_BYTES,
    DatagramSocket,
    Way,
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
        assert server.send(datagrams[-2:], Way((host, client.port))) == 2
        assert take(client, 2) == datagrams[-2:]
        assert client.receive() is None
    finally:
        server.close()
        client.close()


def way_of_next(sock: DatagramSocket) -> Way:
    """Where the next datagram came from, and to."""
    poller = select.poll()
    poller.register(sock.fileno(), select.POLLIN)
    assert poller.poll(5000)
    got = sock.receive()
    assert got is not None
    return got[2]


@pytest.mark.parametrize("segments", [True, False])
@pytest.mark.parametrize(
    ("anywhere", "host", "seen"),
    [
        ("0.0.0.0", "127.0.0.2", socket.inet_aton("127.0.0.2")),
        ("::", "127.0.0.2", socket.inet_pton(socket.AF_INET6, "::ffff:127.0.0.2")),
        ("::", "::1", socket.inet_pton(socket.AF_INET6, "::1")),
    ],
)
def test_an_answer_leaves_from_the_address_that_was_asked(
    anywhere: str, host: str, seen: bytes, segments: bool
) -> None:
    """Of a host's several addresses: a connected socket takes an answer from no other one."""
    server = bind_datagrams(anywhere, 0)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    client = connect_datagrams(family, (host, server.port))
    try:
        server.segments = server.segments and segments
        client.send([b"hello"])
        way = way_of_next(server)
        assert way.local == seen
        answers = [bytes([i]) * 1200 for i in range(5)]
        assert server.send(answers, way) == 5
        assert take(client, 5) == answers
    finally:
        server.close()
        client.close()


def test_an_address_that_has_left_the_machine_costs_no_answer() -> None:
    """The kernel chooses another one then; runs are tried on."""
    server = bind_datagrams("0.0.0.0", 0)
    client = connect_datagrams(socket.AF_INET, ("127.0.0.1", server.port))
    try:
        cuts = server.segments
        client.send([b"hello"])
        gone = way_of_next(server)._replace(local=socket.inet_aton("192.0.2.7"))
        assert server.send([b"a" * 9, b"b" * 9], gone) == 2
        assert take(client, 2) == [b"a" * 9, b"b" * 9]
        assert server.segments == cuts
    finally:
        server.close()
        client.close()


def test_a_socket_of_one_address_asks_for_nothing_more() -> None:
    """The kernel can answer from no other one."""
    server = bind_datagrams("127.0.0.2", 0)
    client = connect_datagrams(socket.AF_INET, ("127.0.0.2", server.port))
    try:
        client.send([b"hello"])
        assert way_of_next(server) == Way(("127.0.0.1", client.port))
    finally:
        server.close()
        client.close()


def test_a_socket_says_how_large_its_buffer_became() -> None:
    """What the kernel granted, and not what was asked for."""
    server = bind_datagrams("127.0.0.1", 0)
    try:
        with open("/proc/sys/net/core/rmem_max", encoding="ascii") as file:
            limit = int(file.read())
        assert server.receive_buffer_bytes == min(limit, SOCKET_BUFFER_BYTES)
    finally:
        server.close()


def test_a_device_that_cannot_cut_gets_single_datagrams(monkeypatch: pytest.MonkeyPatch) -> None:
    """EIO for a run: it is sent again one by one, and runs are not tried any more."""
    server = bind_datagrams("127.0.0.1", 0)
    client = connect_datagrams(socket.AF_INET, ("127.0.0.1", server.port))
    try:
        client.segments = True
        plain = client._send_group

        def refuse(group: list[bytes], way: Way | None) -> None:
            if len(group) > 1:
                raise OSError(errno.EIO, "no checksums on this device")
            plain(group, way)

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
