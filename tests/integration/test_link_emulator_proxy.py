"""The proxies: a bad link where nobody is root."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from link_emulator import Control, ControlError, ImpairmentError, Impairments, TcpProxy, UdpProxy

HERE = "127.0.0.1"


@contextmanager
def udp_echo() -> Iterator[tuple[str, int]]:
    """A server that sends every datagram back."""
    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.bind((HERE, 0))

    def run() -> None:
        while True:
            data, address = server.recvfrom(65536)
            if data == b"end":
                return
            server.sendto(data, address)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield server.getsockname()
    finally:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
            last.sendto(b"end", server.getsockname())
        thread.join()
        server.close()


@contextmanager
def tcp_echo() -> Iterator[tuple[str, int]]:
    """A server that sends every byte back, until the sender ends."""
    listener = socket.create_server((HERE, 0))

    def serve(connection: socket.socket) -> None:
        with connection:
            while data := connection.recv(65536):
                connection.sendall(data)

    def run() -> None:
        threads = []
        while True:
            connection, _ = listener.accept()
            if stopping.is_set():
                connection.close()
                break
            threads.append(threading.Thread(target=serve, args=(connection,)))
            threads[-1].start()
        for thread in threads:
            thread.join()

    stopping = threading.Event()
    acceptor = threading.Thread(target=run)
    acceptor.start()
    try:
        yield listener.getsockname()
    finally:
        stopping.set()
        socket.create_connection(listener.getsockname()).close()
        acceptor.join()
        listener.close()


def udp_to(port: int, timeout_s: float = 10) -> socket.socket:
    """A client's socket."""
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.settimeout(timeout_s)
    client.connect((HERE, port))
    return client


def until(what: Callable[[], object]) -> None:
    """Look until something holds: a relay counts after it has acted, in its own time."""
    give_up = time.monotonic() + 10
    while not what():
        assert time.monotonic() < give_up, "it never came about"
        time.sleep(0.01)


def round_trip_ms(client: socket.socket, payload: bytes) -> float:
    """One ping."""
    start_ns = time.monotonic_ns()
    client.send(payload)
    assert client.recv(65536) == payload
    return (time.monotonic_ns() - start_ns) / 1e6


def test_udp_takes_both_delays() -> None:
    """There and back, never faster."""
    with udp_echo() as server, UdpProxy(server, Impairments(delay_ms=4)) as proxy:
        with udp_to(proxy.port) as client:
            times = [round_trip_ms(client, b"%d" % n) for n in range(50)]
        assert proxy.control.report().up.passed == 50
    assert min(times) >= 8
    assert np.median(times) < 40


def test_udp_clients_get_their_own_answers() -> None:
    """Two clients through one port: the server tells them apart, and so do the answers."""
    with (
        udp_echo() as server,
        UdpProxy(server) as proxy,
        udp_to(proxy.port) as one,
        udp_to(proxy.port) as other,
    ):
        one.send(b"one")
        other.send(b"other")
        assert (one.recv(9), other.recv(9)) == (b"one", b"other")


def test_udp_goes_on_where_a_client_cannot_be_served() -> None:
    """A server of another family: nothing reaches it, and the relay lives."""
    with UdpProxy(("::1", 1)) as proxy, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        for _ in range(3):
            client.sendto(b"x", (HERE, proxy.port))
            time.sleep(0.05)
        assert proxy.control.report() is not None


def test_udp_loss_and_cut_are_counted() -> None:
    """All is lost, then all is cut, then all is well."""
    with udp_echo() as server, UdpProxy(server, Impairments(loss=1), Impairments()) as proxy:
        with udp_to(proxy.port, 0.05) as client:
            for reason, change in (("lost", {"loss": 1}), ("cut", {"loss": 0, "cut": True})):
                proxy.control.change("up", **change)
                client.send(b"x")
                with pytest.raises(TimeoutError):
                    client.recv(9)
                until(lambda reason=reason: proxy.control.report().up.dropped[reason])
            proxy.control.heal()
            client.settimeout(10)
            round_trip_ms(client, b"y")
        report = proxy.control.report()
    assert report.up.dropped["lost"] == report.up.dropped["cut"] == report.up.passed == 1


def exchange(port: int, payload: bytes) -> tuple[bytes, float]:
    """Send all, end, and read all; the seconds that it took."""
    with socket.create_connection((HERE, port)) as client:
        start_ns = time.monotonic_ns()

        def send() -> None:
            client.sendall(payload)
            client.shutdown(socket.SHUT_WR)

        sender = threading.Thread(target=send)
        sender.start()
        back = bytearray()
        while data := client.recv(65536):
            back += data
        sender.join()
        return bytes(back), (time.monotonic_ns() - start_ns) / 1e9


def test_tcp_keeps_the_rate_and_every_byte() -> None:
    """Half a megabyte through 16 Mbit/s takes its time and is unharmed, end of stream included."""
    payload = bytes(range(256)) * 2000
    with tcp_echo() as server, TcpProxy(server, Impairments(rate_mbit=16, delay_ms=2)) as proxy:
        back, seconds = exchange(proxy.port, payload)
    assert back == payload
    assert seconds > len(payload) * 8 / 16e6


def test_tcp_connections_share_the_link() -> None:
    """Two at a time are both served, and together no faster than the rate."""
    payload = bytes(200_000)
    with tcp_echo() as server, TcpProxy(server, Impairments(rate_mbit=16)) as proxy:
        start_ns = time.monotonic_ns()
        backs: list[bytes] = []
        threads = [
            threading.Thread(target=lambda: backs.append(exchange(proxy.port, payload)[0]))
            for _ in range(2)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        seconds = (time.monotonic_ns() - start_ns) / 1e9
    assert backs == [payload, payload]
    assert seconds > 2 * len(payload) * 8 / 16e6


def test_tcp_cut_holds_bytes_back_until_it_heals() -> None:
    """Nothing arrives while it is cut; all of it afterwards."""
    with (
        tcp_echo() as server,
        TcpProxy(server) as proxy,
        socket.create_connection((HERE, proxy.port)) as client,
    ):
        client.settimeout(10)
        client.sendall(b"before")
        assert client.recv(6) == b"before"
        proxy.control.cut()
        client.settimeout(0.1)
        client.sendall(b"after")
        with pytest.raises(TimeoutError):
            client.recv(5)
        proxy.control.heal()
        client.settimeout(10)
        assert client.recv(5) == b"after"


def test_tcp_refuses_what_a_proxy_cannot_do() -> None:
    """It says what it does, and what would do the rest; also while it runs."""
    with pytest.raises(ImpairmentError, match="a TCP proxy cannot do loss.*the TUN relay"):
        TcpProxy((HERE, 1), Impairments(loss=0.1))
    with (
        tcp_echo() as server,
        TcpProxy(server) as proxy,
        pytest.raises(ControlError, match="a TCP proxy cannot do loss"),
    ):
        proxy.control.change(loss=0.1)


def test_server_that_is_not_there_closes_the_client() -> None:
    """The client is told by the end of its connection; the proxy goes on."""
    with socket.create_server((HERE, 0)) as gone:
        place = gone.getsockname()
    with TcpProxy(place) as proxy:
        for _ in range(2):
            with socket.create_connection((HERE, proxy.port), timeout=5) as client:
                assert client.recv(1) == b""


def test_command_line_proxies_and_changes(tmp_path: Path) -> None:
    """`proxy` says its port; `change` cuts it and prints the report."""
    path = tmp_path / "link"
    module = [sys.executable, "-m", "link_emulator"]
    with udp_echo() as server:
        to = f"{HERE}:{server[1]}"
        with subprocess.Popen(
            [*module, "proxy", "udp", "--to", to, "--control", path, "--delay-ms", "1"],
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stderr is not None
            port = int(process.stderr.readline().rpartition(":")[2])
            with udp_to(port) as client:
                round_trip_ms(client, b"x")
                client.settimeout(0.1)
                done = subprocess.run(
                    [*module, "change", "--control", path, "--cut", "--report", "--json"],
                    check=True,
                    capture_output=True,
                )
                assert json.loads(done.stdout)["up"]["passed"] == 1
                client.send(b"y")
                with pytest.raises(TimeoutError):
                    client.recv(1)
            with closing(Control.connect(path)) as control:
                until(lambda: control.report().up.dropped["cut"])
            process.terminate()
            assert process.wait(20) == 0
            assert "1 cut" in process.stderr.read()
    with pytest.raises(ControlError, match="no relay at"):
        Control.connect(path)


@pytest.mark.parametrize("protocol", ["udp", "tcp"])
def test_an_address_that_is_taken_is_named(tmp_path: Path, protocol: str) -> None:
    """Of the port, and of the socket for commands."""
    kind = socket.SOCK_DGRAM if protocol == "udp" else socket.SOCK_STREAM
    command = [sys.executable, "-m", "link_emulator", "proxy", protocol, "--to", f"{HERE}:1"]
    path = tmp_path / "control"
    path.touch()
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind((HERE, 0))
        if protocol == "tcp":
            taken.listen()
        place = f"{HERE}:{taken.getsockname()[1]}"
        for more, message in (
            (["--listen", place], f"cannot listen on {place} (--listen): Address already in use"),
            (["--control", str(path)], f"--control {path}: Address already in use; give a path"),
        ):
            done = subprocess.run(
                [*command, *more], check=False, capture_output=True, text=True, timeout=120
            )
            assert done.returncode == 2
            assert done.stderr.startswith(f"link_emulator: {message}")
            assert len(done.stderr.splitlines()) == 1


def test_mistake_of_a_user_ends_in_one_line() -> None:
    """Exit code 2 and a sentence."""
    for arguments, message in (
        (["run", "--loss", "2", "--", "true"], "loss is 2"),
        (["run"], "nothing to run"),
        (["change", "--control", "/nowhere", "--cut"], "no relay at /nowhere"),
        (["proxy", "udp", "--to", "a..b:7448"], "--to a..b:7448: no name of a host"),
        (["proxy", "udp", "--to", "nosuchhost.invalid:7448"], "--to nosuchhost.invalid:7448: "),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "link_emulator", *arguments],
            check=False,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 2
        assert message in done.stderr
        assert len(done.stderr.splitlines()) == 1
