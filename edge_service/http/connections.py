"""How many connections HTTP has, and which one goes where there are too many."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

MAX_CONNECTIONS = 128


class BoundedProtocol(HttpToolsProtocol):
    """A connection that makes room for itself.

    uvicorn's own bound answers 503 to whoever comes once too many are open, also to the probes of
    the cluster, which restarts a worker for it: anybody who opens sockets and says nothing could
    do that. Here the one goes that has been silent for longest; one that is answered, last of all.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take the connection, and drop another where there are too many."""
        super().connection_made(transport)
        self.made_s = self.loop.time()
        others = [c for c in self.connections if c is not self and not c.transport.is_closing()]
        if len(others) >= MAX_CONNECTIONS:
            min(others, key=_worth).transport.abort()


def _worth(connection: Any) -> tuple[bool, float]:
    """Answered or silent, and since when, of one of this class: uvicorn makes no others here."""
    cycle = connection.cycle
    return cycle is not None and not cycle.response_complete, connection.made_s
