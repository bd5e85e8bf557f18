"""uvicorn inside a process that has its own signal handling and its own socket."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

import uvicorn
from fastapi import FastAPI

from edge_service.errors import AddressError
from edge_service.http.connections import MAX_CONNECTIONS, BoundedProtocol
from rgbd_wire.hosts import resolve


class HttpServer(uvicorn.Server):
    """A server that leaves the signals to the service, which drains before it stops this."""

    def __init__(self, app: FastAPI) -> None:
        config = uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            lifespan="off",
            server_header=False,
            http=BoundedProtocol,
            timeout_graceful_shutdown=2,
        )
        super().__init__(config)

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield


def bind(host: str, port: int) -> socket.socket:
    """A listening socket.

    Raises:
        AddressError: the address is taken, not ours or none.
    """
    try:
        family, kind, protocol, _, address = resolve(
            host, port, socket.SOCK_STREAM, socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
    except OSError as error:
        raise AddressError(_sentence(host, port, error)) from None
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(MAX_CONNECTIONS)
    except OSError as error:
        listener.close()
        raise AddressError(_sentence(host, port, error)) from None
    return listener


def url_of(listener: socket.socket) -> str:
    """Where a listening socket is reached."""
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _sentence(host: str, port: int, error: OSError) -> str:
    return f"HTTP on {host}:{port}: {error.strerror}; give another address with --http or EDGE_HTTP"
