"""Sockets for datagrams: many per system call where the kernel can (UDP_SEGMENT, UDP_GRO)."""

from __future__ import annotations

import errno
import socket
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

from rgbd_wire.hosts import resolve
from rgbd_wire.tunnel.packet import MAX_DATAGRAM_BYTES

Address: TypeAlias = Any
"""What the socket module takes: (host, port) or, for IPv6, four values."""
_UDP_SEGMENT, _UDP_GRO = 103, 104
_SEGMENT = struct.Struct("H")
_GRO = struct.Struct("i")
MAX_SEGMENTS = 54
"""Of 1200 bytes in one UDP payload of at most 65 507; the kernel itself takes 64."""
RECEIVE_BYTES = 65_536
SOCKET_BUFFER_BYTES = 4 * 1024 * 1024
_IP_PKTINFO = 8
_PKTINFO = struct.Struct("=i4s4s")
"""Interface, the address of ours that it came to, and what stood in the datagram."""
_PKTINFO6 = struct.Struct("=16si")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_GRO.size) + socket.CMSG_SPACE(_PKTINFO6.size)
_NO_GSO = frozenset({errno.EIO, errno.EINVAL, errno.EOPNOTSUPP, errno.EMSGSIZE})
"""A device on the way out that cannot: known only when one sends."""
_NOT_OURS = frozenset({errno.EINVAL, errno.EADDRNOTAVAIL, errno.ENETUNREACH})
"""Our address of a moment ago has left this machine: the kernel chooses another one."""


class Way(NamedTuple):
    """Between a peer and us."""

    peer: Address
    local: bytes = b""
    """Our address that it was heard on, 4 or 16 bytes; empty: the kernel knows, or chooses."""


class DatagramSocket:
    """A non-blocking UDP socket with one receive buffer for all its life.

    ``receive`` is for one thread; ``send`` may be called from any.

    Args:
        sock: bound or connected; closed with this.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        sock.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, SOCKET_BUFFER_BYTES)
        # The kernel grants no more than net.core.rmem_max, says nothing, and tells twice of it
        self.receive_buffer_bytes = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
        """What was granted of ``SOCKET_BUFFER_BYTES``."""
        self.segments = _try_option(sock, _UDP_SEGMENT, 0)
        """The kernel cuts what is sent."""
        # The kernel may hand over many datagrams at once; where it cannot, they come one by one
        _try_option(sock, _UDP_GRO, 1)
        _tell_local_address(sock)
        self._view = memoryview(bytearray(RECEIVE_BYTES))

    def fileno(self) -> int:
        """For ``select`` and the like."""
        return self._sock.fileno()

    @property
    def port(self) -> int:
        """The port that it is bound to."""
        return int(self._sock.getsockname()[1])

    def receive(self) -> tuple[memoryview, int, Way] | None:
        """What came: bytes, length of each datagram in them but the last, its way; None: nothing.

        The bytes are those of the one buffer: good until the next call.

        Raises:
            ConnectionRefusedError: on a connected socket, nobody listens there.
            OSError: the socket is closed.
        """
        try:
            size, ancillary, _flags, address = self._sock.recvmsg_into(
                [self._view], _ANCILLARY_BYTES
            )
        except BlockingIOError:
            return None
        segment, local = size, b""
        for level, kind, data in ancillary:
            if level == socket.IPPROTO_UDP and kind == _UDP_GRO and len(data) >= _GRO.size:
                segment = _GRO.unpack_from(data)[0]
            elif level == socket.IPPROTO_IP and kind == _IP_PKTINFO:
                local = _PKTINFO.unpack(data)[1]
            elif level == socket.IPPROTO_IPV6 and kind == socket.IPV6_PKTINFO:
                local = _PKTINFO6.unpack(data)[0]
        return self._view[:size], max(1, segment), Way(address, local)

    def send(self, datagrams: Sequence[bytes], way: Way | None = None) -> int:
        """Send, from the address that the peer knows; a full buffer drops the rest. How many left.

        Raises:
            ConnectionRefusedError: on a connected socket, nobody listens there.
        """
        sent = 0
        for group in _groups(datagrams) if self.segments else ([d] for d in datagrams):
            try:
                self._send_group(group, way)
            except BlockingIOError:
                break
            except ConnectionRefusedError:
                raise
            except OSError as error:
                if error.errno == errno.ENOBUFS:
                    break
                if way is not None and way.local and error.errno in _NOT_OURS:
                    return sent + self.send(datagrams[sent:], Way(way.peer))
                if len(group) == 1 or error.errno not in _NO_GSO:
                    raise
                self.segments = False
                return sent + self.send(datagrams[sent:], way)
            sent += len(group)
        return sent

    def close(self) -> None:
        """Close the socket; may be called twice."""
        self._sock.close()

    def _send_group(self, group: Sequence[bytes], way: Way | None) -> None:
        ancillary = []
        if len(group) > 1:
            size = _SEGMENT.pack(len(group[0]))
            ancillary = [(socket.IPPROTO_UDP, _UDP_SEGMENT, size)]
        if way is None:
            self._sock.sendmsg(group, ancillary)
            return
        # Interface 0: the routes decide by which one it leaves
        if len(way.local) == 4:
            info = _PKTINFO.pack(0, way.local, bytes(4))
            ancillary.append((socket.IPPROTO_IP, _IP_PKTINFO, info))
        elif way.local:
            info = _PKTINFO6.pack(way.local, 0)
            ancillary.append((socket.IPPROTO_IPV6, socket.IPV6_PKTINFO, info))
        self._sock.sendmsg(group, ancillary, 0, way.peer)


def bind_datagrams(host: str, port: int) -> DatagramSocket:
    """A socket bound to an address of this machine.

    Raises:
        OSError: it is no address, not ours, or taken.
    """
    family, _, _, _, address = resolve(host, port, flags=socket.AI_PASSIVE)[0]
    return _with(socket.socket(family, socket.SOCK_DGRAM), lambda s: s.bind(address))


def connect_datagrams(family: int, address: Address) -> DatagramSocket:
    """A socket on a new source port, connected to one address.

    Raises:
        OSError: there is no way there.
    """
    return _with(socket.socket(family, socket.SOCK_DGRAM), lambda s: s.connect(address))


def _with(sock: socket.socket, prepare: Any) -> DatagramSocket:
    try:
        prepare(sock)
        return DatagramSocket(sock)
    except BaseException:
        sock.close()
        raise


def _groups(datagrams: Sequence[bytes]) -> list[list[bytes]]:
    """Runs that one call can send: all of the first one's length, only the last may be shorter."""
    groups: list[list[bytes]] = []
    size = -1
    for datagram in datagrams:
        length = len(datagram)
        if length > size or len(groups[-1]) >= MAX_SEGMENTS:
            groups.append([datagram])
            size = length
        else:
            groups[-1].append(datagram)
            if length < size:
                size = -1  # a shorter one ends its run
    return groups


def _tell_local_address(sock: socket.socket) -> None:
    """Let a socket of all addresses say which one a datagram came to.

    An answer from another one never reaches a peer that is connected to the first.
    """
    host = sock.getsockname()[0]
    if host == "0.0.0.0":
        sock.setsockopt(socket.IPPROTO_IP, _IP_PKTINFO, 1)
    elif host == "::":
        sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_RECVPKTINFO, 1)


def _try_option(sock: socket.socket, option: int, value: int) -> bool:
    try:
        sock.setsockopt(socket.IPPROTO_UDP, option, value)
    except OSError:
        return False
    return True


assert MAX_SEGMENTS * MAX_DATAGRAM_BYTES <= 65_507
