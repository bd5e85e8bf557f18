"""A client's session with ROS 2, opened in the background until somebody answers.

On a thread of its own, for a client's session opens only where somebody listens. Once open, it
connects again by itself.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from contextlib import suppress

import zenoh

from drone_client.errors import LinkError
from drone_client.link.zenoh import check_endpoint
from drone_client.ros.names import MAX_DOMAIN

RETRY_S = 1.0
"""Between two tries to open the session."""


def check_way(endpoints: tuple[str, ...], domain: int) -> None:
    """Whether ROS 2 can be reached like this.

    Raises:
        LinkError: an endpoint is malformed or encrypted, or the domain has no ports in DDS.
    """
    for endpoint in endpoints:
        if not check_endpoint(endpoint).startswith("tcp/"):
            raise LinkError(f"{endpoint}: messages of ROS 2 go over tcp/ alone")
    if not 0 <= domain <= MAX_DOMAIN:
        raise LinkError(f"ROS domain {domain}, expected 0 to {MAX_DOMAIN}")


class ClientOpener:
    """Opens a session with the first of some routers, bridges or peers that answers."""

    def __init__(
        self,
        endpoints: tuple[str, ...],
        prepare: Callable[[zenoh.Session], None],
        thread_name: str,
    ) -> None:
        """Begin to connect.

        Args:
            endpoints: as ``check_way`` lets through.
            prepare: declares what the session is for, on the opener's thread; a ``zenoh.ZError``
                in it closes the session, and it is tried again.
            thread_name: of that thread.
        """
        self._endpoints = endpoints
        self._prepare = prepare
        self._lock = threading.Lock()
        self._session: zenoh.Session | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._open, name=thread_name, daemon=True)
        self._thread.start()

    @property
    def connected(self) -> bool:
        """Whether the session has been opened."""
        return self._session is not None

    def is_alive(self) -> bool:
        """Whether it still tries."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Stop connecting, and close the session."""
        with self._lock:
            self._closing.set()
            session, self._session = self._session, None
        if session is not None:
            _close(session)
        # A try that hangs in a connect ends by itself, and then closes what it opened
        self._thread.join(timeout=RETRY_S)

    def _open(self) -> None:
        while not self._closing.is_set():
            try:
                session = self._opened()
            except zenoh.ZError:
                self._closing.wait(RETRY_S)
                continue
            with self._lock:
                if not self._closing.is_set():
                    self._session = session
                    return
            _close(session)

    def _opened(self) -> zenoh.Session:
        config = zenoh.Config()
        for path, value in _CONFIG.items():
            config.insert_json5(path, json.dumps(value))
        config.insert_json5("connect/endpoints", json.dumps(self._endpoints))
        session = zenoh.open(config)
        try:
            self._prepare(session)
        except zenoh.ZError:
            _close(session)
            raise
        return session


def _close(session: zenoh.Session) -> None:
    """Close it, whatever it says."""
    with suppress(zenoh.ZError):  # a receiver that stands still: 10 s, and then it is left
        session.close()  # type: ignore[no-untyped-call]  # zenoh's stub lacks "-> None"


_CONFIG: dict[str, object] = {
    "mode": "client",
    "connect/timeout_ms": {"client": 0},
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    "listen/endpoints": [],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
    "transport/link/protocols": ["tcp"],
    # Room for some poses while the sending thread gets no core, and no waiting for more: the
    # default of two batches is one pose, and holds up the caller by 1 ms for each that is full
    "transport/link/tx/queue/size/data": 16,
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    # Poses, odometry and distances: whatever comes in is small
    "transport/link/rx/max_message_size": 1_000_000,
}
