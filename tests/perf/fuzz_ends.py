"""Both ends of the tunnel with nothing between them: their own code up to the socket.

Left out are the kernel's socket, ``poll`` and the threads. The rest is the transport of the worker
and the link of the drone as they are, on a clock that stands still until it is told to go on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

from drone_client.link.udp import UdpLink
from drone_client.link.udp_endpoint import Endpoint, Line
from edge_service.transport.udp import UdpTransport
from rgbd_wire.tunnel.datagrams import Way
from rgbd_wire.tunnel.partials import MAX_OPEN_BYTES, MAX_PARTIALS
from rgbd_wire.tunnel.pump import Pump
from rgbd_wire.tunnel.seal import Sealer
from rgbd_wire.tunnel.sending import MAX_COPIES, MAX_KEPT, MAX_WAITING
from rgbd_wire.tunnel.sessions import MAX_HELLOS_PER_DRONE, MAX_PER_DRONE, WorkerSession

WORKER, DRONE = "worker-a", "drone-1"
HOME = "127.0.0.1"
HOUSE_NS = 500_000_000
MAX_SENT = 256
MAX_RECORDED = 64


class StoppedClock:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.ns = 1_000_000_000

    def now_ns(self) -> int:
        return self.ns


class OneKey:
    """The keys of one drone, instead of a file."""

    def __init__(self, key: bytes) -> None:
        self._key = key

    def get(self, drone: str) -> bytes | None:
        return self._key if drone == DRONE else None

    def refresh(self, now_ns: int) -> bool:
        return False


class Wire:
    """In place of a socket: what came is put in, what was sent stays."""

    port = 7448
    _places = count(1024)

    def __init__(self) -> None:
        self.place = (HOME, next(Wire._places) % 65_536)
        self.inbox: deque[tuple[memoryview, int, Any]] = deque()
        self.sent: deque[tuple[bytes, Any]] = deque(maxlen=MAX_SENT)

    def fileno(self) -> int:
        return -1

    def receive(self) -> tuple[memoryview, int, Any] | None:
        return self.inbox.popleft() if self.inbox else None

    def send(self, datagrams: Sequence[bytes], way: Way | None = None) -> int:
        self.sent.extend((datagram, way) for datagram in datagrams)
        return len(datagrams)

    def close(self) -> None:
        self.inbox.clear()


class _WiredEndpoint(Endpoint):
    def _connect(self) -> None:
        self._dialled = Wire()  # type: ignore[assignment]


class Ends:
    """A worker and a drone.

    Args:
        key: of the drone.
        on_message: told of every message that either end took, with what answers it.
    """

    def __init__(self, key: bytes, on_message: Callable[[bytes], None]) -> None:
        self.clock = StoppedClock()
        self._house_ns = 0
        self.wire = Wire()
        self.worker = UdpTransport(WORKER, "udp/127.0.0.1:0", OneKey(key), self.clock)  # type: ignore[arg-type]
        self.worker._socket = self.wire  # type: ignore[assignment]
        self.worker._on_message = lambda drone, data, t2_ns: on_message(bytes(data))
        self.worker.announce()
        self.drone = UdpLink(DRONE, ("udp/127.0.0.1:7448",), key, self.clock)
        self.endpoint = _WiredEndpoint(
            DRONE, key, "127.0.0.1", 7448, self.drone._counters, self.drone._rouse
        )
        self.drone._endpoints = (self.endpoint,)
        self.drone._on_message = lambda data, t4_ns: on_message(data)
        self.drone._on_workers = lambda: None
        self.recorded: deque[bytes] = deque(maxlen=MAX_RECORDED)
        """Authentic datagrams of late, either way."""

    @property
    def line(self) -> Line:
        """The drone's end of the session that stands."""
        assert self.endpoint.line is not None
        return self.endpoint.line

    @property
    def session(self) -> WorkerSession | None:
        """The worker's end of it; None: it ended there."""
        return (
            None
            if self.endpoint.line is None
            else self.worker._sessions.get(self.endpoint.line.channel.session)
        )

    @property
    def sealers(self) -> tuple[Sealer, Sealer]:
        """What seals for the worker, and what seals for the drone."""
        assert self.session is not None
        return self.line.channel._sending._sealer, self.session.channel._sending._sealer

    def connect(self) -> None:
        """Shake hands, as often as it takes."""
        for _ in range(200):
            self.endpoint.redial()
            for _ in range(20):
                self.step(50_000_000)
                self.deliver()
                if self.session is not None and self.line.up and self.endpoint.attempt is None:
                    self.step(0)
                    self.deliver()
                    return
        raise AssertionError("an honest drone does not get in any more")

    def step(self, passed_ns: int) -> None:
        """Let time pass and do what is due, in the order in which the threads would."""
        self.clock.ns += passed_ns
        now_ns = self.clock.ns
        self.worker._tick(now_ns)
        if now_ns >= self._house_ns:
            self._house_ns = now_ns + HOUSE_NS
            self.worker._keep_house(now_ns)
        self.endpoint.step(now_ns)
        self.drone._note_workers()
        self._pump(self.worker._pump)
        self._pump(self.drone._pump)

    def deliver(self) -> None:
        """Give each end what the other one has sent, once."""
        for sock in self.endpoint.sockets():
            assert isinstance(sock, Wire)
            while sock.sent:
                datagram, _ = sock.sent.popleft()
                self.recorded.append(datagram)
                self.to_worker([datagram], len(datagram), sock.place)
        answers = list(self.wire.sent)
        self.wire.sent.clear()
        for datagram, way in answers:
            for sock in self.endpoint.sockets():
                if sock.place == way.peer:  # type: ignore[attr-defined]
                    self.recorded.append(datagram)
                    self.to_drone([datagram], len(datagram), sock)

    def forget(self) -> None:
        """Lose what either end has sent."""
        for sock in (self.wire, *self.endpoint.sockets()):
            assert isinstance(sock, Wire)
            sock.sent.clear()

    def to_worker(self, datagrams: Sequence[bytes], segment: int, address: Any) -> None:
        """Datagrams that came at once at the worker's socket."""
        data = memoryview(b"".join(datagrams))
        self.worker._on_batch(data, segment, Way(address), self.clock.ns)

    def to_drone(self, datagrams: Sequence[bytes], segment: int, sock: Any = None) -> None:
        """Datagrams that came at once at one of the drone's sockets, or at its first one."""
        sockets = self.endpoint.sockets()
        sock = sock or (sockets[0] if sockets else None)
        if sock is not None:
            sock.inbox.append((memoryview(b"".join(datagrams)), segment, None))
            self.drone._drain(self.endpoint, sock)

    def check(self) -> None:
        """Nothing is larger than its bound.

        Raises:
            AssertionError: something is.
        """
        sessions = self.worker._sessions
        assert len(sessions) <= MAX_PER_DRONE
        assert len(sessions._hellos) <= MAX_HELLOS_PER_DRONE
        assert len(sessions._quotas) <= 1
        assert len(self.worker._in_pieces) <= MAX_HELLOS_PER_DRONE
        channels = [s.channel for s in sessions.all()]
        if self.endpoint.line is not None:
            channels.append(self.endpoint.line.channel)
        for channel in channels:
            partials, sending = channel._partials, channel._sending
            assert partials.open_bytes <= MAX_OPEN_BYTES
            assert len(partials._open) <= MAX_PARTIALS
            assert not partials.words
            assert len(sending._kept) <= MAX_KEPT
            assert len(sending._waiting) <= MAX_WAITING + 1
            assert len(sending._copies) <= MAX_COPIES
            assert 1e6 <= sending._pacer.rate_bps <= 10e9
            assert 0 <= sending._loss <= 1
            assert channel._opener.window._bits.bit_length() <= 1024

    def refused(self) -> dict[str, int]:
        """What both ends have counted, by reason."""
        ends = (self.worker.counters(), self.drone.counters())
        return {reason: sum(end[reason] for end in ends) for reason in ends[0]}

    def close(self) -> None:
        """Give back what the link holds."""
        self.worker.close()
        self.drone.close()

    def _pump(self, pump: Pump) -> None:
        now_ns = self.clock.ns
        for channel in [c for c, due_ns in pump._due.items() if due_ns <= now_ns]:
            del pump._due[channel]
            pump.at(channel, channel.pump(now_ns))
