"""The client's way to one endpoint: the session that stands, and the handshake for the next one."""

from __future__ import annotations

import logging
import secrets
import socket
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from rgbd_wire.clock import Clock
from rgbd_wire.hosts import resolve
from rgbd_wire.tunnel.channel import Channel, Side
from rgbd_wire.tunnel.datagrams import Address, DatagramSocket, connect_datagrams
from rgbd_wire.tunnel.errors import Counters, Refusal, TunnelError
from rgbd_wire.tunnel.handshake import (
    NONCE_BYTES,
    Hello,
    Welcome,
    open_welcome,
    pack_hello,
    pack_init,
    parse_cookie,
    parse_hello,
)
from rgbd_wire.tunnel.packet import Type, parse_reset, type_of
from rgbd_wire.tunnel.seal import offered_ciphers

PING_EVERY_NS = 250_000_000
"""Also keeps the way through a NAT open, and measures the round trip."""
SILENT_NS = 1_000_000_000
"""A session that nothing came from for so long is down; four pings were left out."""
FIRST_WAIT_NS, MAX_WAIT_NS = 100_000_000, 1_000_000_000
"""Between tries of one packet of the handshake, and between handshakes; each doubles."""
ATTEMPT_NS = 3_000_000_000
"""After so long without a WELCOME: another socket, the host's name resolved again."""
REDIAL_APART_NS = 500_000_000
"""A handshake that is younger is given its time when another one is asked for."""
LISTEN_ON_NS = 500_000_000
TWIN_WAIT_NS = 2_000_000_000
"""Before an endpoint that leads to a worker which another one leads to is tried again."""
RESEAL_AFTER = 2**27
"""Datagrams under one key, either way; a new session comes long before a cipher's bound."""
Target = tuple[int, Address]
"""Address family and address."""
_log = logging.getLogger(__name__)


@dataclass(eq=False, slots=True)
class Line:
    """A session that a worker has welcomed."""

    sock: DatagramSocket
    worker: str
    channel: Channel
    up: bool = True
    """Frames may go this way."""
    refused: bool = False
    """The worker's machine said that nobody listens there; set from any thread."""
    ping_ns: int = 0
    """When the next one is due."""


@dataclass(eq=False, slots=True)
class Attempt:
    """A handshake under way, on a socket of its own."""

    sock: DatagramSocket
    nonce: bytes
    private: X25519PrivateKey = field(repr=False)
    packet: bytes
    """What is said until it is answered: the INIT, then the HELLO."""
    began_ns: int
    until_ns: int
    next_ns: int
    wait_ns: int = FIRST_WAIT_NS
    hello: Hello | None = None


class Came(NamedTuple):
    """What one batch of datagrams brought."""

    now_ns: int
    """Drone's clock, when it was here."""
    messages: list[bytes]
    welcome: Welcome | None = None
    line: Line | None = None
    """The session in which the messages came."""

    def settle(self) -> None:
        """The messages were handed on: tell the worker what others lack."""
        if self.line is not None:
            self.line.channel.settle(self.now_ns)


class Endpoint:
    """Everything here runs on the link's receiving thread, but ``redial`` and what dials.

    Args:
        drone: its name.
        key: its pre-shared key.
        host: a name or a number.
        port: of the worker.
        counters: where refusals are counted.
        wake: called when a dialled socket is there; makes the thread call ``step``.
    """

    def __init__(
        self,
        drone: str,
        key: bytes,
        host: str,
        port: int,
        counters: Counters,
        wake: Callable[[], None],
    ) -> None:
        self._drone = drone
        self._key = key
        self._host = host
        self._port = port
        self._counters = counters
        self._wake = wake
        self._numeric = _is_number(host)
        self._dialled: DatagramSocket | OSError | None = None
        self._dialling = False
        self._tries = 0
        self._retry_ns = 0
        self._backoff_ns = FIRST_WAIT_NS
        self._redial = False
        self._wanted = False
        self._closed = False
        self.line: Line | None = None
        self.attempt: Attempt | None = None
        self._before: Line | None = None
        self._before_until_ns = 0

    def sockets(self) -> tuple[DatagramSocket, ...]:
        """Those on which something may come."""
        ends = (self.line, self._before, self.attempt)
        return tuple(end.sock for end in ends if end is not None)

    def redial(self) -> None:
        """Shake hands again, from a new source port; the session that stands stays until then."""
        self._redial = True

    def step(self, now_ns: int) -> int:
        """Do what is due; when to come back."""
        due_ns = now_ns + PING_EVERY_NS
        if (line := self.line) is not None:
            due_ns = min(due_ns, self._tend(line, now_ns))
        if self._before is not None:
            self._before.channel.tick(now_ns)
            if now_ns >= self._before_until_ns:
                self._before.sock.close()
                self._before = None
        if self._redial:
            self._redial = False
            self._wanted = True
            if self.attempt is None or now_ns - self.attempt.began_ns > REDIAL_APART_NS:
                self._drop_attempt()
                self._retry_ns = now_ns
        fine = line is not None and line.up and line.channel.packets < RESEAL_AFTER
        if fine and not self._wanted:
            self._drop_attempt()
            return due_ns
        return min(due_ns, self._try(now_ns))

    def receive(self, sock: DatagramSocket, clock: Clock) -> Came | None:
        """Take what came at once on a socket; None: nothing more."""
        try:
            got = sock.receive()
        except ConnectionRefusedError:
            self._on_refused(sock, clock.now_ns())
            return None
        except OSError:
            return None
        if got is None:
            return None
        now_ns = clock.now_ns()
        data, segment, _ = got
        attempt = self.attempt
        if attempt is not None and sock is attempt.sock:
            return Came(now_ns, [], self._on_answers(attempt, data, segment, now_ns))
        for line in (self.line, self._before):
            if line is not None and sock is line.sock:
                if data and data[0] & 15 == Type.DOWN:
                    messages = line.channel.receive(data, segment, now_ns)
                    return Came(now_ns, messages, line=line)
                if line is self.line:
                    self._on_reset(line, data, segment, now_ns)
        return Came(now_ns, [])

    def settle(self, welcome: Welcome, now_ns: int) -> Line:
        """The session of a welcome, in place of the one before it.

        That one is listened to for a while: answers to its frames are on their way.
        """
        attempt = self.attempt
        assert attempt is not None
        self.attempt = None
        self._wanted = False
        self._backoff_ns = FIRST_WAIT_NS
        if self._before is not None:
            self._before.sock.close()
        self._before, self._before_until_ns = self.line, now_ns + LISTEN_ON_NS
        sock = attempt.sock
        line: Line

        def transmit(datagrams: Sequence[bytes]) -> int:
            try:
                return sock.send(datagrams)
            except ConnectionRefusedError:
                line.refused = True
                self._wake()
            except OSError:
                pass  # no way there now, or closed: as good as lost on the way
            return 0

        channel = Channel(welcome.keys, Side.DRONE, transmit, self._counters, now_ns)
        self.line = line = Line(sock, welcome.worker, channel)
        return line

    def dismiss(self, now_ns: int) -> None:
        """Another endpoint leads to the worker of this welcome already."""
        self._drop_attempt()
        self._wanted = False
        self._retry_ns = now_ns + TWIN_WAIT_NS

    def close(self) -> None:
        """Close all sockets."""
        self._closed = True
        self._drop_attempt()
        for line in (self.line, self._before):
            if line is not None:
                line.sock.close()
        self.line = self._before = None
        if isinstance(self._dialled, DatagramSocket):
            self._dialled.close()

    def _tend(self, line: Line, now_ns: int) -> int:
        """Sign of life, lost symbols, is it up; when to come back."""
        channel = line.channel
        tick_ns = channel.tick(now_ns)
        if now_ns >= line.ping_ns:
            line.ping_ns = now_ns + PING_EVERY_NS
            channel.ping(now_ns)
        silent = now_ns - channel.heard_ns > SILENT_NS
        was_up = line.up
        line.up = not (silent or line.refused or channel.said_goodbye)
        if was_up and not line.up:
            self._retry_ns = now_ns
        return line.ping_ns if tick_ns is None else min(tick_ns, line.ping_ns)

    def _try(self, now_ns: int) -> int:
        """The next step of a handshake, or the start of one; when to come back."""
        self._take_dialled(now_ns)
        attempt = self.attempt
        if attempt is not None and now_ns >= attempt.until_ns:
            self._fail(now_ns)
            attempt = None
        if attempt is None:
            if now_ns >= self._retry_ns and not self._dialling:
                self._dial()
                self._take_dialled(now_ns)
                attempt = self.attempt
            if attempt is None:
                return self._retry_ns if self._retry_ns > now_ns else now_ns + MAX_WAIT_NS
        if now_ns >= attempt.next_ns:
            self._say(attempt, now_ns)
        return min(attempt.next_ns, attempt.until_ns) if self.attempt else self._retry_ns

    def _say(self, attempt: Attempt, now_ns: int) -> None:
        attempt.next_ns = now_ns + attempt.wait_ns
        attempt.wait_ns = min(2 * attempt.wait_ns, MAX_WAIT_NS)
        try:
            attempt.sock.send([attempt.packet])
        except OSError:
            self._fail(now_ns)

    def _fail(self, now_ns: int) -> None:
        """A handshake came to nothing: another one after a while."""
        self._drop_attempt()
        self._retry_ns = now_ns + self._backoff_ns
        self._backoff_ns = min(2 * self._backoff_ns, MAX_WAIT_NS)

    def _dial(self) -> None:
        """Make a connected socket; on another thread if a name has to be resolved."""
        self._dialling = True
        if self._numeric:
            self._connect()
        else:
            threading.Thread(target=self._connect, name="udp-resolve", daemon=True).start()

    def _connect(self) -> None:
        try:
            found = resolve(self._host, self._port)
            family, _, _, _, address = found[self._tries % len(found)]
            dialled = connect_datagrams(family, address)
        except OSError as error:
            self._dialled = error
        else:
            self._dialled = dialled
            if self._closed:
                dialled.close()
                return
        if not self._numeric:
            self._wake()

    def _take_dialled(self, now_ns: int) -> None:
        dialled, self._dialled = self._dialled, None
        if dialled is None:
            return
        self._dialling = False
        self._tries += 1
        if isinstance(dialled, OSError):
            if self._tries == 1:
                _log.warning("udp/%s:%d: %s", self._host, self._port, dialled)
            self._fail(now_ns)
            return
        nonce = secrets.token_bytes(NONCE_BYTES)
        self._drop_attempt()
        self.attempt = Attempt(
            dialled,
            nonce,
            X25519PrivateKey.generate(),
            pack_init(nonce),
            began_ns=now_ns,
            until_ns=now_ns + ATTEMPT_NS,
            next_ns=now_ns,
        )

    def _on_refused(self, sock: DatagramSocket, now_ns: int) -> None:
        """Nobody listens there: faster than any time-out."""
        if self.line is not None and sock is self.line.sock:
            self.line.refused = True
        elif self.attempt is not None and sock is self.attempt.sock:
            self._fail(now_ns)

    def _on_answers(
        self, attempt: Attempt, data: memoryview, segment: int, now_ns: int
    ) -> Welcome | None:
        for start in range(0, len(data), segment):
            try:
                welcome = self._on_handshake(attempt, data[start : start + segment], now_ns)
            except TunnelError as error:
                self._counters.count(error.reason)
                continue
            if welcome is not None:
                return welcome
        return None

    def _on_handshake(self, attempt: Attempt, datagram: memoryview, now_ns: int) -> Welcome | None:
        """Answer a COOKIE, read a WELCOME.

        Raises:
            TunnelError: it is neither, or not for us.
        """
        kind = type_of(datagram)
        if kind is Type.COOKIE:
            nonce, cookie = parse_cookie(datagram)
            if nonce != attempt.nonce:
                raise TunnelError(Refusal.BAD_COOKIE, "of another INIT")
            if attempt.hello is not None:
                return None  # of an INIT that was said twice
            public_key = attempt.private.public_key().public_bytes_raw()
            attempt.packet = pack_hello(
                self._drone, self._key, nonce, cookie, public_key, offered_ciphers()
            )
            attempt.hello = parse_hello(attempt.packet)
            attempt.wait_ns = FIRST_WAIT_NS
            self._say(attempt, now_ns)
            return None
        if kind is Type.WELCOME and attempt.hello is not None:
            return open_welcome(datagram, attempt.hello, self._key, attempt.private)
        raise TunnelError(Refusal.UNWANTED, f"a {kind.name}")

    def _on_reset(self, line: Line, data: memoryview, segment: int, now_ns: int) -> None:
        """A RESET is a hint that nobody signed: shake hands, and keep the session until then."""
        try:
            if type_of(data) is not Type.RESET:
                raise TunnelError(Refusal.UNWANTED, "not for a session that stands")
            if parse_reset(data[:segment]) != line.channel.session:
                raise TunnelError(Refusal.UNKNOWN_SESSION, "a RESET of another session")
        except TunnelError as error:
            self._counters.count(error.reason)
            return
        if self.attempt is None and not self._dialling and now_ns >= self._retry_ns:
            self._redial = True
            self._retry_ns = now_ns + self._backoff_ns

    def _drop_attempt(self) -> None:
        if self.attempt is not None:
            self.attempt.sock.close()
            self.attempt = None


def _is_number(host: str) -> bool:
    try:
        socket.getaddrinfo(host, None, flags=socket.AI_NUMERICHOST)
    except (OSError, UnicodeError):
        return False
    return True
