"""A slow link for TCP, without root: delay, jitter, rate and partition, and nothing else.

A proxy ends the connection on both sides, so a lost packet cannot be had here: what TCP makes of
loss is between two kernels, and needs the TUN relay. A partition holds bytes back.
"""

from __future__ import annotations

import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from link_emulator.errors import ImpairmentError
from link_emulator.impairments import Impairments
from link_emulator.lane import Lane
from link_emulator.loop import Loop
from link_emulator.path import Path

CHUNK_BYTES = 1448
"""What a segment carries on Ethernet."""
HEADER_BYTES = 52
MAX_INSIDE_BYTES = 1 << 22
MIN_INSIDE_BYTES = 1 << 16
_NO_BOUND = 1 << 40


def check_for_tcp(impairments: Impairments) -> Impairments:
    """The impairments themselves, if a TCP proxy can do them.

    Raises:
        ImpairmentError: says which it cannot, and what can.
    """
    for name in ("loss", "reorder", "cuts_ms"):
        if getattr(impairments, name):
            raise ImpairmentError(
                f"a TCP proxy cannot do {name}: it does delay, jitter, rate and cut; "
                "the TUN relay (as root) does everything"
            )
    return impairments


class _Half:
    """One direction of one connection."""

    def __init__(self, way: _Way, source: socket.socket, sink: socket.socket) -> None:
        self.way = way
        self.source = source
        self.sink = sink
        self.unsent: deque[bytes] = deque()
        """Due, but not taken by the sink yet; an empty one is the end."""
        self.ended = False
        """Its source sends no more."""
        self.done = False
        """And its sink knows."""


class _Way:
    """One direction of the link, which all connections share."""

    def __init__(self, impairments: Impairments, seed: int) -> None:
        self.path = Path(_for_path(impairments), seed)
        self.is_cut = impairments.cut
        self.inside_bytes = 0
        self.max_inside_bytes = _inside(impairments)
        self.halves: list[_Half] = []


class TcpRelay:
    """Connections from any client to one server.

    Args:
        listen: host and port; port 0 is any free one.
        server: host and port.
        up: from clients to the server.
        down: back.
        seed: of the jitter.

    Raises:
        ImpairmentError: a TCP proxy cannot do what is asked.
    """

    def __init__(
        self,
        listen: tuple[str, int],
        server: tuple[str, int],
        up: Impairments,
        down: Impairments,
        seed: int = 0,
    ) -> None:
        self._server = server
        self._listener = socket.create_server(listen)
        self._listener.setblocking(False)
        ways = [_Way(check_for_tcp(i), seed + n) for n, i in enumerate((up, down))]
        self.up, self.down = (Lane(way.path, self._on_due, time.monotonic_ns) for way in ways)
        self._ways = {id(lane): way for lane, way in zip((self.up, self.down), ways, strict=True)}
        self._lanes = {id(way): lane for lane, way in zip((self.up, self.down), ways, strict=True)}
        self._both = ways
        self.loop = Loop((self.up, self.down))
        self.loop.add(self._listener.fileno(), self._on_client)

    @property
    def port(self) -> int:
        """Where it listens."""
        port: int = self._listener.getsockname()[1]
        return port

    def change(self, lane: Lane[tuple[_Half, bytes]], impairments: Impairments) -> None:
        """Make one direction do something else.

        Raises:
            ImpairmentError: a TCP proxy cannot.
        """
        check_for_tcp(impairments)
        way = self._ways[id(lane)]
        way.path.change(_for_path(impairments))
        way.max_inside_bytes = _inside(impairments)
        way.is_cut = impairments.cut
        for half in tuple(way.halves):
            self._flush(half)

    def _on_client(self) -> None:
        try:
            client, _ = self._listener.accept()
        except OSError:  # gone already
            return
        try:
            server = socket.create_connection(self._server, timeout=5)
        except OSError:
            client.close()
            return
        up, down = self._both
        for way, source, sink in ((up, client, server), (down, server, client)):
            source.setblocking(False)
            source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            half = _Half(way, source, sink)
            way.halves.append(half)
            self.loop.add(source.fileno(), self._reader(half))

    def _reader(self, half: _Half) -> Callable[[], None]:
        def on_readable() -> None:
            way = half.way
            if way.inside_bytes >= way.max_inside_bytes:
                self.loop.remove(half.source.fileno())  # until something has left
                return
            try:
                data = half.source.recv(CHUNK_BYTES)
            except BlockingIOError:
                return
            except OSError:
                self._close(half)
                return
            if not data:
                self.loop.remove(half.source.fileno())
                half.ended = True
            way.inside_bytes += len(data)
            lane = self._lanes[id(way)]
            size_bytes = len(data) + HEADER_BYTES if data else 0
            lane.offer((half, data), size_bytes, time.monotonic_ns())

        return on_readable

    def _on_due(self, item: tuple[_Half, bytes]) -> bool:
        half, data = item
        if half.sink.fileno() < 0:
            half.way.inside_bytes -= len(data)
            return False
        half.unsent.append(data)
        self._flush(half)
        return True

    def _flush(self, half: _Half) -> None:
        way, sink = half.way, half.sink
        fd = sink.fileno()
        if way.is_cut or fd < 0:
            return
        while half.unsent:
            data = half.unsent[0]
            try:
                if not data:
                    half.unsent.clear()
                    half.done = True
                    sink.shutdown(socket.SHUT_WR)
                    if any(each.source is sink and each.done for each in self._all()):
                        self._close(half)
                        return
                    break
                sent = sink.send(data)
            except BlockingIOError:
                self.loop.add_writer(fd, lambda: self._flush(half))
                return
            except OSError:
                self._close(half)
                return
            way.inside_bytes -= sent
            if sent == len(data):
                half.unsent.popleft()
            else:
                half.unsent[0] = data[sent:]
        self.loop.remove_writer(fd)
        for other in way.halves:
            if not other.ended and other.source.fileno() >= 0:
                self.loop.add(other.source.fileno(), self._reader(other))

    def _all(self) -> list[_Half]:
        return [half for way in self._both for half in way.halves]

    def _close(self, half: _Half) -> None:
        """A connection broke or is over: end both its sides."""
        for end in (half.source, half.sink):
            if end.fileno() >= 0:
                self.loop.remove(end.fileno())
                self.loop.remove_writer(end.fileno())
        ends = {half.source, half.sink}
        for way in self._both:
            for each in way.halves:
                if each.source in ends:
                    way.inside_bytes -= sum(map(len, each.unsent))
                    each.unsent.clear()
            way.halves = [each for each in way.halves if each.source not in ends]
        for end in ends:
            end.close()


def _for_path(impairments: Impairments) -> Impairments:
    """Nothing is dropped on the way: what does not fit is not read."""
    return replace(impairments, queue_bytes=_NO_BOUND, cut=False)


def _inside(impairments: Impairments) -> int:
    """Bytes that may be in the proxy: what the link holds, and its queue."""
    if impairments.rate_mbit is None:
        return MAX_INSIDE_BYTES
    i = impairments
    holds_ms = i.delay_ms + i.jitter_ms + i.queue_ms
    holds = impairments.rate_mbit * 1e3 / 8 * holds_ms
    if i.queue_bytes is not None:
        holds = impairments.rate_mbit * 1e3 / 8 * (i.delay_ms + i.jitter_ms) + i.queue_bytes
    return max(MIN_INSIDE_BYTES, min(MAX_INSIDE_BYTES, round(holds)))
