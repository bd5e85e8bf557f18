"""Addresses of a host's name."""

from __future__ import annotations

import socket
from typing import Any


def resolve(
    host: str, port: int, kind: int = socket.SOCK_DGRAM, flags: int = 0
) -> list[tuple[socket.AddressFamily, socket.SocketKind, int, str, Any]]:
    """``getaddrinfo``, for names that people type: family, kind, protocol, name, address of each.

    Raises:
        OSError: there is no such host, or that is no name; Python raises UnicodeError for one with
            a label that is empty or too long.
    """
    try:
        return list(socket.getaddrinfo(host, port, type=kind, flags=flags))
    except UnicodeError as error:
        raise socket.gaierror(socket.EAI_NONAME, f"not a host name ({error})") from None
