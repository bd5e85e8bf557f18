"""A transport without a network: what tests hand frames to and read answers from."""

from __future__ import annotations

import threading

from edge_service.transport import OnFrame
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.messages import Ack, Result, decode_ack, decode_result


class MemoryTransport:
    """Keeps what was sent, in order, as it would arrive at the drones."""

    def __init__(self) -> None:
        self.is_open = False
        self.announced = False
        self.sent: list[tuple[str, Ack | Result]] = []
        """Drone and message."""
        self._on_frame: OnFrame | None = None
        self._changed = threading.Condition()

    def open(self) -> None:
        """Open it."""
        self.is_open = True

    def start(self, on_frame: OnFrame) -> None:
        """Hand over what ``deliver`` is given."""
        self._on_frame = on_frame

    def deliver(self, data: bytes | memoryview, t2_ns: int) -> None:
        """Hand over one message, as if it had come in at ``t2_ns``."""
        assert self.is_open, "deliver before close"
        assert self._on_frame is not None, "deliver after start"
        self._on_frame(data, t2_ns)

    def announce(self) -> None:
        """Note it."""
        self.announced = True

    def withdraw(self) -> None:
        """Note it."""
        self.announced = False

    def send(self, drone: str, payload: bytes) -> bool:
        """Decode the message as a drone would, and keep it."""
        if not self.is_open:
            return False
        kind, body = unseal(payload, Kind.ACK, Kind.RESULT)
        message = decode_ack(body) if kind is Kind.ACK else decode_result(body)
        with self._changed:
            self.sent.append((drone, message))
            self._changed.notify_all()
        return True

    def close(self) -> None:
        """Close it."""
        self.is_open = False

    def acks(self) -> list[Ack]:
        """All acks so far."""
        return [m for _, m in self.sent if isinstance(m, Ack)]

    def results(self) -> list[Result]:
        """All results so far."""
        return [m for _, m in self.sent if isinstance(m, Result)]

    def wait_for_results(self, n: int, timeout_s: float = 20.0) -> list[Result]:
        """All results so far, once there are ``n``.

        Raises:
            TimeoutError: there were fewer within ``timeout_s``.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: len(self.results()) >= n, timeout_s):
                raise TimeoutError(f"{len(self.results())} results in {timeout_s} s, not {n}")
            return self.results()
