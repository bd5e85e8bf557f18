"""The transport over the UDP tunnel: one socket, one thread that receives, sealed sessions."""

from __future__ import annotations

import logging
import os
import secrets
import select
import threading
import time
from collections.abc import Mapping, Sequence

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from edge_service.errors import AddressError
from edge_service.transport import OnMessage
from rgbd_wire.clock import Clock, MonotonicClock
from rgbd_wire.streams import RESULT
from rgbd_wire.tunnel.bucket import Bucket
from rgbd_wire.tunnel.channel import Channel, Side
from rgbd_wire.tunnel.datagrams import (
    SOCKET_BUFFER_BYTES,
    DatagramSocket,
    Way,
    bind_datagrams,
)
from rgbd_wire.tunnel.endpoint import parse_endpoint
from rgbd_wire.tunnel.errors import Counters, EndpointError, Refusal, TunnelError
from rgbd_wire.tunnel.faults import REST_S, Faults
from rgbd_wire.tunnel.handshake import (
    Hello,
    answer_hello,
    check_cookie,
    check_hello,
    make_cookie,
    pack_cookie,
    parse_hello,
    parse_init,
)
from rgbd_wire.tunnel.keys import KeyFile
from rgbd_wire.tunnel.packet import RESET_BYTES, Type, first_byte, pack_reset, type_of
from rgbd_wire.tunnel.pump import Pump
from rgbd_wire.tunnel.seal import choose_cipher, offered_ciphers
from rgbd_wire.tunnel.sessions import MAX_SESSIONS, MESSAGES_HZ, Sessions, WorkerSession
from rgbd_wire.tunnel.shards import MAX_MESSAGE_BYTES

HOUSEKEEPING_NS = 500_000_000
INITS_HZ, INITS_BURST = 5000.0, 500
"""Of all addresses together; what is past it is dropped unread, and an honest drone tries again.
A HELLO needs no bound: its cookie costs a hash to check, and its drone may have few sessions."""
RESETS_HZ, RESETS_BURST = 100.0, 50
DATAGRAM_NS = 10_000
"""Work on a datagram, as a drone's quota counts it: what costs more, such as decoding the largest
message with losses (0.1 s), is charged as more datagrams."""
GOODBYE_AGAIN_NS = 100_000_000
MAX_BATCHES = 32
"""Taken from the socket before the timers are looked at again."""
ANSWER_BUDGET_NS = int(RESULT.max_age_ms * 1e6)
_UP = first_byte(Type.UP)
_NOBODY = bytes(32)
_log = logging.getLogger(__name__)


class UdpTransport:
    """A worker's end of the tunnel.

    Args:
        worker: its name.
        endpoint: where it listens, ``udp/HOST:PORT``; port 0 is any free one.
        keys: of the drones; looked at again once a second.
        clock: the worker's.
        max_sessions: of all drones together.
        messages_hz: of one drone that are handed over.
    """

    def __init__(
        self,
        worker: str,
        endpoint: str,
        keys: KeyFile,
        clock: Clock | None = None,
        max_sessions: int = MAX_SESSIONS,
        messages_hz: float = MESSAGES_HZ,
    ) -> None:
        self._worker = worker
        self._endpoint = endpoint
        self._keys = keys
        self._clock = clock or MonotonicClock()
        now_ns = self._clock.now_ns()
        self._secret = secrets.token_bytes(32)
        self._counters = Counters()
        self._faults = Faults(self._counters)
        self._sessions = Sessions(max_sessions, messages_hz)
        self._inits = Bucket(INITS_HZ, INITS_BURST, now_ns)
        self._resets = Bucket(RESETS_HZ, RESETS_BURST, now_ns)
        self._in_pieces: set[WorkerSession] = set()
        self._pump = Pump("udp-send", self._clock, self._faults)
        self._announced = False
        self._closed = False
        self._socket: DatagramSocket | None = None
        self._thread: threading.Thread | None = None
        self._on_message: OnMessage | None = None

    @property
    def is_open(self) -> bool:
        """The socket stands, and once started, its thread runs."""
        return self._socket is not None and not self._closed and self.is_alive

    @property
    def is_alive(self) -> bool:
        """Both threads run, or are not started yet, or were stopped."""
        if self._thread is None or self._closed:
            return True
        return self._thread.is_alive() and self._pump.is_alive

    @property
    def port(self) -> int:
        """The port on which it listens, once it is open."""
        assert self._socket is not None, "open first"
        return self._socket.port

    @property
    def place(self) -> str:
        """``HOST:PORT`` where it listens; port 0, any free one, only before it is open."""
        host = self._endpoint.removeprefix("udp/").rpartition(":")[0]
        port = self._endpoint.rpartition(":")[2] if self._socket is None else self._socket.port
        return f"{host}:{port}"

    def counters(self) -> Mapping[str, int]:
        """How much was refused, by reason."""
        return self._counters.snapshot()

    def sessions(self) -> int:
        """How many sessions there are."""
        return len(self._sessions)

    def open(self) -> None:
        """Bind the socket.

        Raises:
            AddressError: the endpoint is malformed, not ours or taken.
        """
        try:
            host, port = parse_endpoint(self._endpoint)
            self._socket = bind_datagrams(host, port)
        except EndpointError as error:
            raise AddressError(str(error)) from None
        except OSError as error:
            raise AddressError(
                f"{self._endpoint}: {error.strerror or error}; give another address"
            ) from None
        granted = self._socket.receive_buffer_bytes
        if granted < SOCKET_BUFFER_BYTES:
            _log.warning(
                "the tunnel's receive buffer holds %d B of %d: when frames of several drones come "
                "at once, some are lost; sysctl -w net.core.rmem_max=%d on the worker's host",
                granted,
                SOCKET_BUFFER_BYTES,
                SOCKET_BUFFER_BYTES,
            )

    def start(self, on_message: OnMessage) -> None:
        """Receive; hellos are answered from ``announce`` on."""
        assert self._socket is not None, "open before start"
        self._on_message = on_message
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._pump.start()
        self._thread = threading.Thread(target=self._run, name="udp-receive", daemon=True)
        self._thread.start()

    def announce(self) -> None:
        """Answer hellos from now on."""
        self._announced = True

    def withdraw(self) -> None:
        """Answer no more hellos, and tell every drone to go elsewhere."""
        if not self._announced:
            return
        self._announced = False
        for session in self._sessions.all():
            session.channel.goodbye()

    def send(self, drone: str, payload: bytes) -> bool:
        """Send to the drone's newest session; False: it has none."""
        session = self._sessions.current(drone)
        if session is None or self._closed or not 0 < len(payload) <= MAX_MESSAGE_BYTES:
            return False
        self._send(session.channel, payload)
        return True

    def publish(self, status: bytes) -> None:
        """Send a status to every drone that is here."""
        if not self._closed:
            for session in self._sessions.currents():
                self._send(session.channel, status)

    def close(self) -> None:
        """Stop both threads and close the socket."""
        if self._closed:
            return
        self.withdraw()
        self._closed = True
        if self._thread is not None:
            os.eventfd_write(self._wake, 1)
            self._thread.join()
            os.close(self._wake)
        self._pump.close()
        if self._socket is not None:
            self._socket.close()

    def _send(self, channel: Channel, payload: bytes) -> None:
        due_ns = channel.send_urgent(payload, ANSWER_BUDGET_NS, self._clock.now_ns())
        self._pump.at(channel, due_ns)

    def _run(self) -> None:
        assert self._socket is not None
        sock, clock = self._socket, self._clock
        poller = select.poll()
        poller.register(sock.fileno(), select.POLLIN)
        poller.register(self._wake, select.POLLIN)
        self._housekeeping_ns = due_ns = clock.now_ns()
        while not self._closed:
            try:
                poller.poll(max(0.0, (due_ns - clock.now_ns()) / 1e6))
                self._receive(sock)
                due_ns = self._do_due(clock.now_ns())
            except Exception as error:  # the thread's boundary: it serves all drones
                self._faults.note(error, "the receiving thread")
                time.sleep(REST_S)

    def _receive(self, sock: DatagramSocket) -> None:
        """Take what came."""
        for _ in range(MAX_BATCHES):
            got = sock.receive()
            if got is None:
                return
            with self._faults.contained("a datagram's handling"):
                self._on_batch(*got, self._clock.now_ns())

    def _do_due(self, now_ns: int) -> int:
        """What the time brings; when to come back."""
        if now_ns >= self._housekeeping_ns:
            self._housekeeping_ns = now_ns + HOUSEKEEPING_NS
            self._keep_house(now_ns)
        return min(self._housekeeping_ns, self._tick(now_ns))

    def _tick(self, now_ns: int) -> int:
        """Ask for lost symbols; when to come back."""
        next_ns = now_ns + HOUSEKEEPING_NS
        for session in tuple(self._in_pieces):
            due_ns = session.channel.tick(now_ns)
            if due_ns is None:
                self._in_pieces.discard(session)
            else:
                next_ns = min(next_ns, due_ns)
        return next_ns

    def _keep_house(self, now_ns: int) -> None:
        self._refresh_keys(now_ns)
        self._sessions.expire(now_ns)
        self._in_pieces.intersection_update(self._sessions.all())

    def _refresh_keys(self, now_ns: int) -> None:
        if self._keys.refresh(now_ns):
            for session in self._sessions.all():
                if self._keys.get(session.drone) != session.key:
                    _log.info("the key of %s changed: its session ends", session.drone)
                    self._sessions.end(session)

    def _on_batch(self, data: memoryview, segment: int, way: Way, now_ns: int) -> None:
        """Datagrams of one sender that came at once."""
        if data and data[0] == _UP:
            self._on_sealed(data, segment, way, now_ns)
            return
        for start in range(0, len(data), segment):
            try:
                self._on_handshake(data[start : start + segment], way, now_ns)
            except TunnelError as error:
                self._counters.count(error.reason)

    def _on_sealed(self, data: memoryview, segment: int, way: Way, now_ns: int) -> None:
        number = int.from_bytes(data[1:9], "little")
        session = self._sessions.get(number)
        if session is None:
            self._counters.count(Refusal.UNKNOWN_SESSION)
            if min(segment, len(data)) > RESET_BYTES and self._resets.take(now_ns):
                self._answer(pack_reset(number), way)
            return
        quota = session.quota
        if quota.datagrams.is_empty(now_ns):
            # Unread: what a flood costs is one look at its first datagram
            self._counters.count(Refusal.DRONE_RATE, -(-len(data) // segment))
            return
        channel = session.channel
        newest, count = channel.newest_number, channel.received
        began_ns = time.thread_time_ns()
        messages = channel.receive(data, segment, now_ns)
        # Only what is authentic counts: who knows a session's id cannot use its drone's quota up
        if authentic := channel.received - count:
            spent_ns = time.thread_time_ns() - began_ns
            quota.datagrams.spend(max(authentic, spent_ns // DATAGRAM_NS))
        if channel.newest_number > newest:
            session.way = way
            self._sessions.heard(session)
        self._hand_over(session, messages, now_ns)
        channel.settle(now_ns)
        if channel.in_pieces:
            self._in_pieces.add(session)
        if authentic and not self._announced:
            self._goodbye_again(session, now_ns)

    def _hand_over(self, session: WorkerSession, messages: list[bytes], now_ns: int) -> None:
        for message in messages:
            if not session.quota.messages.take(now_ns):
                self._counters.count(Refusal.DRONE_RATE)
            elif self._on_message is not None:
                with self._faults.contained("the application"):
                    self._on_message(session.drone, message, now_ns)

    def _goodbye_again(self, session: WorkerSession, now_ns: int) -> None:
        """The drone still talks to a worker that has withdrawn: maybe it did not hear that."""
        if now_ns - session.goodbye_ns > GOODBYE_AGAIN_NS:
            session.goodbye_ns = now_ns
            session.channel.goodbye()

    def _on_handshake(self, datagram: memoryview, way: Way, now_ns: int) -> None:
        """Answer an INIT or a HELLO.

        Raises:
            TunnelError: why it was not answered.
        """
        kind = type_of(datagram)
        if kind not in (Type.INIT, Type.HELLO):
            raise TunnelError(Refusal.UNWANTED, f"a {kind.name}")
        if not self._announced:
            raise TunnelError(Refusal.NOT_ANNOUNCED, "before announce, or after withdraw")
        place = repr(way.peer[:2]).encode()
        if kind is Type.INIT:
            nonce = parse_init(datagram)
            if not self._inits.take(now_ns):
                raise TunnelError(Refusal.HANDSHAKE_RATE, "too many INITs")
            cookie = make_cookie(self._secret, place, nonce, now_ns)
            self._answer(pack_cookie(nonce, cookie), way)
            return
        hello = parse_hello(datagram)
        check_cookie(self._secret, place, hello, now_ns)
        self._refresh_keys(now_ns)
        key = self._keys.get(hello.drone)
        if key is None:
            # The same work as for a wrong MAC, so that time does not tell which names exist
            self._check_nobody(hello)
            raise TunnelError(Refusal.UNKNOWN_DRONE, hello.drone)
        check_hello(hello, key)
        self._answer(self._welcome(hello, key, way, now_ns), way)

    def _check_nobody(self, hello: Hello) -> None:
        try:
            check_hello(hello, _NOBODY)
        except TunnelError:
            return

    def _welcome(self, hello: Hello, key: bytes, way: Way, now_ns: int) -> bytes:
        """The answer to a HELLO that is authentic: the same to the same HELLO."""
        known, session = self._sessions.of_hello(hello.packet)
        if session is not None:
            return session.welcome
        if known:
            raise TunnelError(Refusal.REPLAYED, "its session has ended")
        if not self._sessions.make_room(hello.drone):
            raise TunnelError(Refusal.SESSION_LIMIT, f"{len(self._sessions)} sessions")
        cipher = choose_cipher(hello.ciphers, offered_ciphers())
        number = secrets.randbits(64)
        welcome, keys = answer_hello(
            hello, key, self._worker, number, cipher, X25519PrivateKey.generate()
        )
        quota = self._sessions.quota(hello.drone, now_ns)
        made = WorkerSession(hello.drone, key, way, welcome, quota, now_ns)

        def transmit(datagrams: Sequence[bytes]) -> int:
            return self._transmit(datagrams, made.way)

        made.channel = Channel(keys, Side.WORKER, transmit, self._counters, now_ns)
        self._sessions.add(made, hello.packet)
        return welcome

    def _answer(self, datagram: bytes, way: Way) -> None:
        if not self._transmit([datagram], way):
            self._counters.count(Refusal.NOT_SENT)

    def _transmit(self, datagrams: Sequence[bytes], way: Way) -> int:
        assert self._socket is not None
        try:
            return self._socket.send(datagrams, way)
        except OSError:
            return 0  # no way there now, or closed: as good as lost on the way
