"""The two ends of a bench run, one process each: ``python -m tests.perf.bench_link_ends JOB``.

A job is JSON (see ``Job``). The receiving end prints "ready", serves until its stdin closes and
prints what arrived: a list of [number, t_capture_ns, t_arrival_ns], frames that were whole alone.
The sending end loads what it needs, waits for a line on its stdin, and at its end prints the
numbers of the frames that it sent. All stamps are CLOCK_MONOTONIC of one
machine.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import import_module
from typing import Any

import numpy as np

DRONE, WORKER = "drone-1", "worker-a"
STAMP = struct.Struct("<qI")
"""Time of capture and number: the first bytes of every frame of the baselines."""
PART = struct.Struct("<IHHq")
"""Frame, part, parts and time of capture: the head of a bare datagram."""
DATAGRAM_BYTES = 1200
BUFFER_BYTES = 1 << 23
"""Asked of the kernel for the receiver of bare datagrams: what is lost is lost on the link."""
CONNECT_S = 15.0
NICE = -10
"""Where it may: what else the machine does shall not be measured."""
Arrivals = list[tuple[int, int, int]]


@dataclass(frozen=True, slots=True)
class Job:
    """What one end does."""

    role: str
    """send or receive; or, for round trips, ask or answer."""
    contender: str
    host: str
    """Of the receiving end."""
    port: int
    size_bytes: int
    rate_hz: float
    seconds: float
    window: int
    """Of the ack clock; the baselines have none."""
    folder: str
    """Keys and certificates of both ends."""

    def as_argument(self) -> str:
        """For a command line."""
        return json.dumps(asdict(self))


def captures(job: Job) -> Iterator[tuple[int, int]]:
    """Number and time of each capture, at its time.

    Those that a sender misses while it is blocked are left out, as by a camera.
    """
    start_ns = time.monotonic_ns()
    number = 0
    while number < round(job.rate_hz * job.seconds):
        due_ns = start_ns + round(number * 1e9 / job.rate_hz)
        if (wait_ns := due_ns - time.monotonic_ns()) > 0:
            time.sleep(wait_ns / 1e9)
        now_ns = time.monotonic_ns()
        yield number, now_ns
        missed_to = int((time.monotonic_ns() - start_ns) * job.rate_hz / 1e9)
        number = max(number, missed_to) + 1


def frame_bytes(job: Job, number: int, t_capture_ns: int, filler: bytes) -> bytes:
    """A frame of a baseline: its stamp, and bytes that nobody can compress."""
    return STAMP.pack(t_capture_ns, number) + filler[STAMP.size : job.size_bytes]


class Sink:
    """Takes whole frames from any thread, each once."""

    def __init__(self) -> None:
        self._arrivals: dict[int, tuple[int, int]] = {}
        self._lock = threading.Lock()

    def take(self, number: int, t_capture_ns: int) -> None:
        """A frame is whole now."""
        now_ns = time.monotonic_ns()
        with self._lock:
            self._arrivals.setdefault(number, (t_capture_ns, now_ns))

    def take_stamped(self, data: bytes | bytearray) -> None:
        """A baseline's frame."""
        t_capture_ns, number = STAMP.unpack_from(data)
        self.take(number, t_capture_ns)

    def arrivals(self) -> Arrivals:
        """All so far."""
        with self._lock:
            return [(number, *times) for number, times in sorted(self._arrivals.items())]


# ---- bare UDP: no acknowledgement, no parity, no pacing


def send_udp(job: Job) -> list[int]:
    """Every frame at its time, all its datagrams at once."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
    sock.connect((job.host, job.port))
    filler = np.random.default_rng(0).bytes(job.size_bytes)
    room = DATAGRAM_BYTES - PART.size
    parts = -(-job.size_bytes // room)
    sent = []
    for number, t_capture_ns in captures(job):
        for part in range(parts):
            head = PART.pack(number, part, parts, t_capture_ns)
            sock.send(head + filler[part * room : (part + 1) * room])
        sent.append(number)
    return sent


def receive_udp(job: Job, sink: Sink, stop: threading.Event) -> None:
    """A frame counts when all its parts are here."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    sock.bind((job.host, job.port))
    sock.settimeout(0.1)
    here: dict[int, set[int]] = {}
    _ready()
    while not stop.is_set():
        try:
            data = sock.recv(2048)
        except TimeoutError:
            continue
        number, part, parts, t_capture_ns = PART.unpack_from(data)
        got = here.setdefault(number, set())
        got.add(part)
        if len(got) == parts:
            sink.take(number, t_capture_ns)
            for old in [n for n in here if n < number - 100]:
                del here[old]


# ---- raw TCP


def send_tcp(job: Job) -> list[int]:
    """Every frame at its time, unless the one before still blocks."""
    sock = socket.create_connection((job.host, job.port))
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    filler = np.random.default_rng(0).bytes(job.size_bytes)
    sent = []
    for number, t_capture_ns in captures(job):
        sock.sendall(frame_bytes(job, number, t_capture_ns, filler))
        sent.append(number)
    return sent


def receive_tcp(job: Job, sink: Sink, stop: threading.Event) -> None:
    """Frames of a known length, one after the other; each is answered by its stamp."""
    listener = socket.create_server((job.host, job.port))
    _ready()
    connection, _ = listener.accept()
    connection.settimeout(0.1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    buffer, filled = bytearray(job.size_bytes), 0
    while not stop.is_set():
        try:
            got = connection.recv_into(memoryview(buffer)[filled:])
        except TimeoutError:
            continue
        if not got:
            return
        filled += got
        if filled == job.size_bytes:
            filled = 0
            sink.take_stamped(buffer)
            if job.role == "answer":
                connection.sendall(buffer[: STAMP.size])


# ---- plain Zenoh: a put for each frame, no ack clock


def _plain_zenoh(mode: str, place: str, endpoint: str) -> Any:
    import zenoh

    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        f"{place}/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def _send_plain_zenoh(job: Job, *, block: bool) -> list[int]:
    import zenoh

    session = _plain_zenoh("peer", "connect", f"tcp/{job.host}:{job.port}")
    control = zenoh.CongestionControl.BLOCK if block else zenoh.CongestionControl.DROP
    publisher = session.declare_publisher("bench/frame", congestion_control=control)
    deadline = time.monotonic() + CONNECT_S
    while not publisher.matching_status.matching:
        if time.monotonic() > deadline:
            raise TimeoutError("the subscriber was not found")
        time.sleep(0.01)
    filler = np.random.default_rng(0).bytes(job.size_bytes)
    sent = []
    for number, t_capture_ns in captures(job):
        publisher.put(frame_bytes(job, number, t_capture_ns, filler))
        sent.append(number)
    time.sleep(1.0)  # what is queued has its chance; closing would throw it away
    return sent


def receive_plain_zenoh(job: Job, sink: Sink, stop: threading.Event) -> None:
    """A subscriber with a callback, as anyone would write it."""
    session = _plain_zenoh("router", "listen", f"tcp/{job.host}:{job.port}")
    session.declare_subscriber("bench/frame", lambda s: sink.take_stamped(s.payload.to_bytes()))
    _ready()
    stop.wait()


# ---- round trips: a frame up, a small answer down, one at a time


def ask_tcp(job: Job) -> list[float]:
    """Round trips [ms] of frames at their times."""
    sock = socket.create_connection((job.host, job.port))
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    filler = np.random.default_rng(0).bytes(job.size_bytes)
    times = []
    for number, t_capture_ns in captures(job):
        sock.sendall(frame_bytes(job, number, t_capture_ns, filler))
        sock.recv(STAMP.size, socket.MSG_WAITALL)
        times.append((time.monotonic_ns() - t_capture_ns) / 1e6)
    return times


def ask_ours(job: Job) -> list[float]:
    """The same over one of our links, from ``send`` to the worker's ack."""
    from tests.perf.bench_link_ours import ask

    return ask(job)


# ---- ours: the drone's real uplink, and the worker's real transport with an immediate answer


def _send_ours(job: Job) -> list[int]:
    from tests.perf.bench_link_ours import send

    return send(job)


def receive_ours(job: Job, sink: Sink, stop: threading.Event) -> None:
    """The worker's transport; every frame is acknowledged and answered at once."""
    from tests.perf.bench_link_ours import receive

    receive(job, sink, stop, _ready)


SENDERS: dict[str, Callable[[Job], list[int]]] = {
    "udp": send_udp,
    "tcp": send_tcp,
    "zenoh-drop": lambda job: _send_plain_zenoh(job, block=False),
    "zenoh-block": lambda job: _send_plain_zenoh(job, block=True),
    "our-zenoh": _send_ours,
    "our-tunnel": _send_ours,
}
RECEIVERS: dict[str, Callable[[Job, Sink, threading.Event], None]] = {
    "udp": receive_udp,
    "tcp": receive_tcp,
    "zenoh-drop": receive_plain_zenoh,
    "zenoh-block": receive_plain_zenoh,
    "our-zenoh": receive_ours,
    "our-tunnel": receive_ours,
    "our-zenoh-tls": receive_ours,
}
ASKERS: dict[str, Callable[[Job], list[float]]] = {
    "tcp": ask_tcp,
    "our-zenoh-tls": ask_ours,
    "our-tunnel": ask_ours,
}


def _ready() -> None:
    print("ready", flush=True)


def main() -> None:
    """Do the job; the process ends by force, since what some libraries leave running would not."""
    job = Job(**json.loads(sys.argv[1]))
    with suppress(OSError):
        os.nice(NICE)
    if job.contender.startswith("our-"):
        import_module("tests.perf.bench_link_ours")
    elif job.contender.startswith("zenoh-"):
        import_module("zenoh")
    if job.role in ("send", "ask"):
        sys.stdin.readline()
    if job.role == "send":
        print(json.dumps(SENDERS[job.contender](job)), flush=True)
    elif job.role == "ask":
        print(json.dumps(ASKERS[job.contender](job)), flush=True)
    else:
        sink, stop = Sink(), threading.Event()
        args = (job, sink, stop)
        threading.Thread(target=RECEIVERS[job.contender], args=args, daemon=True).start()
        sys.stdin.read()
        stop.set()
        print(json.dumps(sink.arrivals()), flush=True)
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
