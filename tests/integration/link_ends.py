"""Small senders and receivers that run inside the namespaces; the clock is the machine's."""

from __future__ import annotations

import json
import socket
import struct
import sys
import time

STAMP = struct.Struct("<qI")
IP_UDP_BYTES = 28
QUIET_S = 1.0


def send(host: str, port: int, count: int, size_bytes: int, rate_hz: float) -> None:
    """UDP datagrams, each with its number and the time at which it left."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect((host, port))
    filler = bytes(size_bytes - STAMP.size)
    start_ns = time.monotonic_ns()
    for number in range(count):
        wait_s = (start_ns + number * 1e9 / rate_hz - time.monotonic_ns()) / 1e9
        if wait_s > 0:
            time.sleep(wait_s)
        sock.send(STAMP.pack(time.monotonic_ns(), number) + filler)


def receive(port: int) -> None:
    """Print a JSON list of [number, sent_ns, arrived_ns, bytes], once nothing comes any more."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    sock.bind(("0.0.0.0", port))
    print("ready", flush=True)
    got = []
    sock.settimeout(None)
    while True:
        try:
            data = sock.recv(65536)
        except TimeoutError:
            break
        now_ns = time.monotonic_ns()
        sent_ns, number = STAMP.unpack_from(data)
        got.append([number, sent_ns, now_ns, len(data) + IP_UDP_BYTES])
        sock.settimeout(QUIET_S)
    print(json.dumps(got))


def echo_udp(port: int) -> None:
    """Send every datagram back to where it came from."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("0.0.0.0", port))
    print("ready", flush=True)
    while True:
        data, address = sock.recvfrom(65536)
        sock.sendto(data, address)


def echo_tcp(port: int) -> None:
    """Send every byte back, one connection after the other."""
    listener = socket.create_server(("0.0.0.0", port))
    print("ready", flush=True)
    while True:
        connection, _ = listener.accept()
        with connection:
            while data := connection.recv(65536):
                connection.sendall(data)


def ask(host: str, port: int, kind: str, count: int, timeout_s: float) -> None:
    """Print the round-trip times [ms] of so many pings, None for what did not come back."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM)
    sock.settimeout(timeout_s)
    sock.connect((host, port))
    times: list[float | None] = []
    for number in range(count):
        start_ns = time.monotonic_ns()
        sock.send(b"%08d" % number)
        try:
            sock.recv(100)
            times.append((time.monotonic_ns() - start_ns) / 1e6)
        except TimeoutError:
            times.append(None)
    print(json.dumps(times))


def congestion(host: str, port: int) -> None:
    """Print the congestion control of a connection."""
    with socket.create_connection((host, port)) as sock:
        name = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, 16)
    print(json.dumps(name.rstrip(b"\0").decode()))


def upload(host: str, port: int, size_bytes: int) -> None:
    """Send so much over TCP to an echo; print the seconds until all is back, unharmed."""
    import threading

    payload = bytes(i * 7 % 251 for i in range(1009)) * (size_bytes // 1009 + 1)
    payload = payload[:size_bytes]
    sock = socket.create_connection((host, port))
    start_ns = time.monotonic_ns()
    sender = threading.Thread(target=lambda: (sock.sendall(payload), sock.shutdown(1)))
    sender.start()
    back = bytearray()
    while data := sock.recv(65536):
        back += data
    sender.join()
    print(json.dumps({"seconds": (time.monotonic_ns() - start_ns) / 1e9, "same": back == payload}))


if __name__ == "__main__":
    name, *rest = sys.argv[1:]
    globals()[name](*(json.loads(a) if a[:1].isdigit() and "." not in a[2:] else a for a in rest))
