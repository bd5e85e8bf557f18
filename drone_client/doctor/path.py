"""The way of the UDP tunnel's datagrams: does one fit through it whole."""

from __future__ import annotations

import socket
from dataclasses import dataclass

from drone_client.doctor.finding import Check, Finding, judged, unchecked
from rgbd_wire.hosts import resolve
from rgbd_wire.tunnel.endpoint import parse_endpoint
from rgbd_wire.tunnel.packet import MAX_DATAGRAM_BYTES

AREA = "service"
_IP_MTU, _IPV6_MTU = 14, 24
"""Of linux/in.h and linux/in6.h; Python names neither."""
HEAD_BYTES = {socket.AF_INET: 28, socket.AF_INET6: 48}
"""IP's and UDP's own."""


@dataclass(frozen=True, slots=True)
class PathFacts:
    """What the kernel knows of the way to one endpoint."""

    endpoint: str
    mtu_bytes: int | None = None
    """Largest packet: of the interface, or what a router on the way has said; None: not told."""
    head_bytes: int = HEAD_BYTES[socket.AF_INET]
    error: str = ""
    """Why there is no way there; empty: there is."""


def collect_path(endpoint: str) -> PathFacts:
    """Ask the kernel; nothing is sent.

    Args:
        endpoint: ``udp/HOST:PORT``.

    Raises:
        EndpointError: it is none.
    """
    host, port = parse_endpoint(endpoint)
    try:
        family, kind, _, _, address = resolve(host, port)[0]
        with socket.socket(family, kind) as sock:
            sock.connect(address)
            is_v6 = family == socket.AF_INET6
            level, option = (
                (socket.IPPROTO_IPV6, _IPV6_MTU) if is_v6 else (socket.IPPROTO_IP, _IP_MTU)
            )
            try:
                mtu = sock.getsockopt(level, option)
            except OSError:  # not Linux
                mtu = None
            return PathFacts(endpoint, mtu, HEAD_BYTES[family])
    except OSError as error:
        return PathFacts(endpoint, error=error.strerror or type(error).__name__)


def judge_path(facts: PathFacts) -> Check:
    """Whether the tunnel's datagrams fit."""
    name = f"path to {facts.endpoint}"
    needed = MAX_DATAGRAM_BYTES + facts.head_bytes
    if facts.error:
        return judged(
            AREA,
            name,
            Finding.FAULT,
            facts.error,
            "is the name right, is the network up, is there a route?",
        )
    if facts.mtu_bytes is None:
        return unchecked(AREA, name, "this system does not tell its largest packet")
    return judged(
        AREA,
        name,
        Finding.OK if facts.mtu_bytes >= needed else Finding.FAULT,
        f"packets of {facts.mtu_bytes} B",
        f"the tunnel's have {needed} B and would be cut up or lost: raise the interface's MTU "
        "(ip link set dev DEVICE mtu ...), or take a VPN with smaller heads",
    )
